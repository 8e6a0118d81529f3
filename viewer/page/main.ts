/** The page of an Object File. */

import { App, type Settings } from "./app.ts";
import { element } from "./elements.ts";

declare global {
  interface Window {
    /** The page, for tests and scripts. */
    objectfolder?: App;
  }
}

try {
  const settings = JSON.parse(element("settings").textContent ?? "{}") as Settings;
  window.objectfolder = new App(settings);
} catch (error) {
  const message = document.getElementById("message");
  if (!message) throw error;
  message.hidden = false;
  message.textContent = error instanceof Error ? error.message : String(error);
}
