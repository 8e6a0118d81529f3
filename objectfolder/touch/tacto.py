"""Our re-implementation of TACTO's renderer (Wang et al. 2022) on pyrender, as a reference."""

import numpy as np

from objectfolder.base.errors import ObjectFolderError
from objectfolder.touch.camera import gel_sag
from objectfolder.touch.optics import Optics
from objectfolder.touch.profiles import SensorProfile
from objectfolder.touch.tacto_rays import NEAR_PLANE, compose, sensor_poses, smooth_normals
from objectfolder.vision.renderers.registry import NEEDS

#: Grey levels, deviation of the Gaussian noise that TACTO adds to each image.
NOISE_STD = 7.0

# Vertices of the gel's grid along its shorter side, as in TACTO's DIGIT.
_GEL_VERTICES = 100
# Size of the gel relative to the view at the apex: 20 mm across the DIGIT.
_GEL_MARGIN = 1.05
_GAMMA = 2.2  # of pyrender's shader
_FAR_PLANE = 1.0  # m


class TactoReference:
    """Renderer of the object in front of a rigid gel with OpenGL; adds the difference to a background.

    Assumed, because the published descriptions of TACTO do not state it: the near plane is 1 mm from the
    camera, lights do not cast shadows, and the object is drawn with the gel's grey coating and with smooth
    normals. The force model is left out: contacts have a given depth. TACTO's noise is off unless asked for.

    Parameters and ``background`` are those of `objectfolder.touch.tacto_rays.TactoRays`. Raises
    ObjectFolderError if OpenGL or pyrender is missing, or pyrender cannot draw the profile.
    """

    def __init__(self, vertices: np.ndarray, faces: np.ndarray, profile: SensorProfile, scale: float = 1.0):
        try:
            from objectfolder.vision.renderers.raster import canvas, pyrender

            self._canvas = canvas()
        except ImportError as error:
            raise ObjectFolderError(
                f"the tacto reference renderer cannot run here ({error}): install {NEEDS['raster']}; "
                "everything else works without it"
            ) from error
        if profile.gamma != _GAMMA or profile.ambient != 0:
            raise ObjectFolderError(
                f"sensor profile {profile.name!r}: gamma = {profile.gamma:g}, ambient = {profile.ambient:g}; "
                f"TACTO's renderer draws gamma {_GAMMA:g} and no ambient light only"
            )
        self.profile = profile
        self.background = Optics(profile).background.numpy()
        vertices, faces = np.asarray(vertices, np.float64) * scale, np.asarray(faces, np.int64)
        grey = (profile.albedo, profile.albedo, profile.albedo, 1.0)
        material = pyrender.MetallicRoughnessMaterial(
            baseColorFactor=grey, metallicFactor=profile.metallic, roughnessFactor=profile.roughness
        )

        def mesh(positions: np.ndarray, normals: np.ndarray, indices: np.ndarray | None) -> pyrender.Mesh:
            drawn = {"indices": indices, "material": material, "mode": pyrender.GLTF.TRIANGLES}
            return pyrender.Mesh([pyrender.Primitive(positions, normals, **drawn)])

        self._scene = pyrender.Scene(bg_color=np.zeros(4), ambient_light=np.zeros(3))
        # pyrender's camera looks along -z, with y up and x to the right.
        pose = np.eye(4)
        pose[:3, :3] = np.array([[0, 0, -1], [-1, 0, 0], [0, 1, 0]])
        field, aspect = np.radians(profile.vertical_fov_deg), profile.width / profile.height
        camera = pyrender.PerspectiveCamera(field, NEAR_PLANE, _FAR_PLANE, aspectRatio=aspect)
        self._scene.add(camera, pose=pose)
        for light in profile.lights:
            pose = np.eye(4)
            pose[:3, 3] = light.position
            self._scene.add(pyrender.PointLight(np.array(light.color, float), light.intensity), pose=pose)
        triangles = gel_triangles(profile)
        sides = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
        sides /= np.linalg.norm(sides, axis=1, keepdims=True)
        self._scene.add(mesh(triangles.reshape(-1, 3), np.repeat(sides, 3, axis=0), None))
        self._empty, self._empty_depth = self._draw()
        self._object = self._scene.add(mesh(vertices, smooth_normals(vertices, faces), faces))

    def render(
        self,
        points: np.ndarray,
        normals: np.ndarray,
        angles: np.ndarray,
        depths: np.ndarray,
        noise: np.random.Generator | None = None,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Press the sensor on the object; images (N, H, W, 3) uint8, RGB, and contacts (N, H, W) bool.

        Contacts are those of `objectfolder.touch.tacto_rays.TactoRays.render`; they touch where the object is
        in front of the gel. A generator adds TACTO's pixel noise, of deviation `NOISE_STD`.
        """
        cameras, frames = sensor_poses(points, normals, angles, depths, self.profile)
        images = np.empty((len(frames), *self.background.shape), np.uint8)
        contact = np.empty(images.shape[:3], bool)
        for i, (camera, frame) in enumerate(zip(cameras, frames)):
            pose = np.eye(4)
            pose[:3, :3] = frame.T
            pose[:3, 3] = -frame.T @ camera
            self._scene.set_pose(self._object, pose)
            color, depth = self._draw()
            background = self.background
            if noise is not None:
                background = background + noise.normal(0, NOISE_STD, background.shape)
            images[i] = compose(color, self._empty, background, self.profile)
            contact[i] = depth < self._empty_depth
        return images, contact

    def _draw(self) -> tuple[np.ndarray, np.ndarray]:
        """Return colours (H, W, 3) uint8 and depths (H, W), metres, of the current scene."""
        self._canvas.viewport_width, self._canvas.viewport_height = self.profile.width, self.profile.height
        return self._canvas.render(self._scene)


def gel_triangles(profile: SensorProfile) -> np.ndarray:
    """Return the undeformed gel as triangles (F, 3, 3), metres, camera frame, facing the camera."""
    vertical, horizontal = profile.half_extent
    half = np.array([horizontal, vertical]) * profile.camera_to_gel * _GEL_MARGIN
    count = np.round(half / half.min() * (_GEL_VERTICES - 1)).astype(int) + 1
    y, z = np.meshgrid(*(np.linspace(-h, h, n) for h, n in zip(half, count)))
    grid = np.stack([profile.camera_to_gel - gel_sag(profile, np.hypot(y, z)), y, z], axis=-1)
    a, b, c, d = grid[:-1, :-1], grid[:-1, 1:], grid[1:, :-1], grid[1:, 1:]
    return np.concatenate([np.stack(t, axis=2).reshape(-1, 3, 3) for t in ((a, c, b), (b, c, d))])
