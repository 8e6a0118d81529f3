// Build the script and the page that the Python package ships: node build.mjs [OUT]
import { createHash } from "node:crypto";
import { mkdirSync, readFileSync, writeFileSync } from "node:fs";
import { build } from "esbuild";

const out = process.argv[2] ?? "../objectfolder/viewer/static";
const options = {
  bundle: true,
  write: false,
  minify: true,
  target: "es2022",
  format: "iife",
  charset: "utf8",
};

const text = async (entry, extra = {}) => {
  const { outputFiles } = await build({ ...options, ...extra, entryPoints: [entry] });
  return outputFiles[0].text.trim();
};

// A page from disk may start a worker from a text of its own, not from a file beside it.
const worker = await text("worker/main.ts");
const inline = {
  name: "worker",
  setup(to) {
    to.onResolve({ filter: /^worker-source$/ }, ({ path }) => ({ path, namespace: "worker" }));
    to.onLoad({ filter: /.*/, namespace: "worker" }, () => ({ contents: worker, loader: "text" }));
  },
};
// esbuild leaves texts as they are; a shader's comments and spaces are a kilobyte.
const shaders = {
  name: "shaders",
  setup(to) {
    to.onLoad({ filter: /shaders\.ts$/ }, ({ path }) => ({
      contents: readFileSync(path, "utf8").replace(
        /(`#version.*\n)([^`]*)/g,
        (_, first, rest) => first + rest.replace(/ *\/\/.*/g, "").replace(/\s*([^\w\s.])\s*/g, "$1"),
      ),
      loader: "ts",
    }));
  },
};
mkdirSync(out, { recursive: true });
const script = await text("page/main.ts", { plugins: [inline, shaders] });

const hash = (content) => `'sha256-${createHash("sha256").update(content).digest("base64")}'`;
// Within a page, </script would end the script.
const write = (name, content) => {
  const written = `${content.replaceAll("</script", "<\\/script")}\n`;
  writeFileSync(`${out}/${name}`, written);
  return hash(written);
};
// Whatever else gets into a page is not run, and loads and sends nothing.
const writePage = (name, source, style, scripts, styles, more) => {
  const policy = [
    "default-src 'none'",
    `script-src ${scripts.join(" ")}`,
    `style-src ${[style, ...styles].map(hash).join(" ")}`,
    "img-src data:",
    ...more,
    "base-uri 'none'",
    "form-action 'none'",
  ].join(";");
  const filled = { policy, style };
  const page = readFileSync(source, "utf8").replace(/\/\* (policy|style) \*\//g, (_, part) => filled[part]);
  writeFileSync(`${out}/${name}`, page);
};
const viewer = write("viewer.js", script);
const style = await text("page/style.css");
writePage("page.html", "page/page.html", style, [viewer], [], ["worker-src blob:"]);
// The live viewer in its frame takes over the report's policy besides its own. The report loads scripts beside it.
const scripts = [write("report.js", await text("report/main.ts")), viewer, "'self' file:"];
const reading = ["media-src data:", "worker-src blob:"];
writePage("report.html", "report/report.html", await text("report/report.css"), scripts, [style], reading);
const listening = [write("listening.js", await text("listening/main.ts"))];
const listeningStyle = await text("listening/listening.css");
writePage("listening.html", "listening/listening.html", listeningStyle, listening, [], ["media-src data:"]);
