/** Direct light of the vision net: principled BSDF under point lights with their shadows, as core/bsdf.ts. */

export const LIGHTS = 3;

export const VERTEX = `#version 300 es
layout(location = 0) in vec3 position;
layout(location = 1) in vec3 normal;
layout(location = 2) in vec3 color;
layout(location = 3) in vec3 shading;
layout(location = 4) in vec3 indirect;
uniform mat4 camera;
out vec3 vPosition, vNormal, vColor, vShading, vIndirect;
void main() {
  vPosition = position;
  vNormal = normal;
  vColor = color;
  vShading = shading;
  vIndirect = indirect;
  gl_Position = camera * vec4(position, 1.0);
}`;

export const FRAGMENT = `#version 300 es
precision highp float;
precision highp sampler2DArrayShadow;
in vec3 vPosition, vNormal, vColor, vShading, vIndirect;
uniform vec3 eye, lights[${LIGHTS}], intensities[${LIGHTS}], accent;
uniform mat4 lightMatrices[${LIGHTS}];
uniform sampler2DArrayShadow shadows;
uniform float roughness, metallic, texel, lift;
uniform int count, mode;
uniform vec4 mark;
out vec4 result;
const float PI = 3.14159265;
const float HORIZON = 0.1; // sine of the angle at which light passes a face of a voxel that turns away

float schlick(float c) {
  float r = clamp(1.0 - c, 0.0, 1.0);
  return r * r * r * r * r;
}
float dielectric(float c) {
  c = clamp(c, 0.0, 1.0);
  float i = sqrt(1.0 - (1.0 - c * c) / 2.25);
  float a = (c - 1.5 * i) / (c + 1.5 * i), b = (i - 1.5 * c) / (i + 1.5 * c);
  return 0.5 * (a * a + b * b);
}
float masking(float c, float s) {
  return 2.0 * c / (c + sqrt(s + (1.0 - s) * c * c));
}
vec3 principled(vec3 n, vec3 view, vec3 l, vec3 base) {
  float seen = -dot(n, view), received = dot(n, l);
  if (seen <= 0.0 || received <= 0.0) return vec3(0);
  seen = max(seen, 1e-4);
  received = max(received, 1e-6);
  vec3 h = normalize(l - view);
  float g = dot(h, l), s = max(0.001, roughness * roughness), along = dot(n, h);
  s *= s;
  vec3 across = h - along * n;
  float spread = s * along * along + dot(across, across);
  vec3 f = vec3((1.0 - metallic) * dielectric(g)) + metallic * (base + (1.0 - base) * schlick(g));
  vec3 specular = 0.25 * f * s / (spread * spread) * masking(seen, s) * masking(received, s) / seen;
  float a = schlick(received), e = schlick(seen), r = 2.0 * roughness * g * g;
  float diffuse = (1.0 - 0.5 * a) * (1.0 - 0.5 * e) + r * (a + e + a * e * (r - 1.0));
  return specular + (1.0 - metallic) * base * received * diffuse;
}
float lit(int k, vec3 normal) {
  vec4 q = lightMatrices[k] * vec4(vPosition + normal * lift, 1.0);
  vec3 c = q.xyz / q.w * 0.5 + 0.5;
  float sum = 0.0;
  for (int i = -1; i <= 1; i++)
    for (int j = -1; j <= 1; j++)
      sum += texture(shadows, vec4(c.xy + vec2(i, j) * texel, float(k), c.z));
  return sum / 9.0;
}
vec3 encoded(vec3 c) {
  c = clamp(c, 0.0, 1.0);
  return mix(12.92 * c, 1.055 * pow(c, vec3(1.0 / 2.4)) - 0.055, step(0.0031308, c));
}
void main() {
  vec3 geometric = normalize(vNormal), normal = normalize(vShading), view = normalize(vPosition - eye);
  vec3 face = normalize(cross(dFdx(vPosition), dFdy(vPosition)));
  if (dot(face, view) > 0.0) face = -face;
  vec3 radiance = vIndirect;
  float shone = 0.0;
  for (int k = 0; k < ${LIGHTS}; k++) {
    if (k >= count) break;
    vec3 to = lights[k] - vPosition;
    vec3 way = normalize(to);
    vec3 direct = principled(normal, view, way, vColor) / max(dot(to, to), 1e-6);
    if (direct.r + direct.g + direct.b <= 0.0) continue;
    float share = dot(face, way) > -HORIZON ? lit(k, geometric) : 0.0; // a face shades itself
    radiance += intensities[k] * direct * share;
    shone += step(0.5, share) * float(k + 1);
  }
  if (mode > 0) {
    result = mode == 1 ? vec4(radiance, 1.0) : vec4(geometric, 10.0 * (1.0 + shone));
    return;
  }
  vec3 shown = encoded(radiance);
  float off = length(vPosition - mark.xyz), width = fwidth(off);
  if (mark.w > 0.0) {
    float ring = 1.0 - smoothstep(0.5, 1.5, (abs(off - mark.w) - 0.0015) / width);
    float dot = 1.0 - smoothstep(0.5, 1.5, (off - 0.004) / width);
    shown = mix(shown, accent, max(ring, dot));
  }
  result = vec4(shown, 1.0);
}`;

export const DEPTH_VERTEX = `#version 300 es
layout(location = 0) in vec3 position;
uniform mat4 camera;
void main() {
  gl_Position = camera * vec4(position, 1.0);
}`;

export const DEPTH_FRAGMENT = `#version 300 es
precision mediump float;
void main() {}`;
