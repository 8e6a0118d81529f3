// Headless Chromium with a page from disk, for tests and measurements.
import { existsSync } from "node:fs";
import { chromium } from "playwright-core";

/** Where Debian and others put it; CHROMIUM names another place. */
export const executable = [process.env.CHROMIUM, "/usr/bin/chromium", "/usr/bin/google-chrome"].find(
  (path) => path && existsSync(path),
);

// SwiftShader draws without a graphics card.
const FLAGS = [
  "--no-sandbox",
  "--use-angle=swiftshader",
  "--enable-unsafe-swiftshader",
  "--ignore-gpu-blocklist",
];

/** Open a page; `complaints` collects errors of the console, exceptions and requests to a network. */
export async function open(file, { width = 1280, height = 800, ...context } = {}) {
  const browser = await chromium.launch({ executablePath: executable, args: FLAGS });
  const page = await browser.newPage({ viewport: { width, height }, ...context });
  const complaints = [];
  page.on("console", (message) => {
    if (["error", "warning"].includes(message.type())) complaints.push(`console: ${message.text()}`);
  });
  page.on("pageerror", (error) => complaints.push(`exception: ${error.message}`));
  page.on("request", (request) => {
    if (!/^(file|data|blob):/.test(request.url())) complaints.push(`request: ${request.url()}`);
  });
  await page.goto(`file://${file}`);
  return { browser, page, complaints };
}
