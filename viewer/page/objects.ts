/** Objects that the page holds, and files that its reader opens. */

import { fromBase64 } from "../core/base64.ts";

/** Object Files as base64, by name: in script elements of the page, or set by scripts beside it. */
export interface Embedded {
  name: string;
  read(): ArrayBuffer;
}

export function embedded(): Embedded[] {
  return [...document.querySelectorAll<HTMLScriptElement>("script[data-object]")].map((script) => ({
    name: script.dataset.object!,
    read: () => fromBase64(script.textContent ?? "").buffer,
  }));
}

/** Call a function with each file that is chosen or dropped on the page. */
export function whenOpened(chooser: HTMLInputElement, call: (file: File) => void): void {
  chooser.addEventListener("change", () => {
    const [file] = chooser.files ?? [];
    if (file) call(file);
    chooser.value = "";
  });
  const mark = (on: boolean) => document.body.classList.toggle("dropping", on);
  window.addEventListener("dragover", (event) => {
    event.preventDefault();
    mark(true);
  });
  window.addEventListener("dragleave", () => mark(false));
  window.addEventListener("drop", (event) => {
    event.preventDefault();
    mark(false);
    const [file] = event.dataTransfer?.files ?? [];
    if (file) call(file);
  });
}
