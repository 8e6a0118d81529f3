// Build the script and the page that the Python package ships: node build.mjs [OUT]
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

// Within a page, </script would end the script.
const write = (name, content) =>
  writeFileSync(`${out}/${name}`, `${content.replaceAll("</script", "<\\/script")}\n`);
const writePage = async (name, source, style) => {
  const styled = await text(style);
  writeFileSync(
    `${out}/${name}`,
    readFileSync(source, "utf8").replace("/* style */", () => styled),
  );
};
write("viewer.js", script);
write("report.js", await text("report/main.ts"));
write("listening.js", await text("listening/main.ts"));
await writePage("page.html", "page/page.html", "page/style.css");
await writePage("report.html", "report/report.html", "report/report.css");
await writePage("listening.html", "listening/listening.html", "listening/listening.css");
