/** Objects that the page holds, and files that its reader opens. */

import { fromBase64 } from "../core/base64.ts";

/** An Object File that can be shown. */
export interface Source {
  name: string;
  read(): ArrayBuffer | Promise<ArrayBuffer>;
}

/** Object Files as base64 in script elements of the page. */
export function embedded(): Source[] {
  return [...document.querySelectorAll<HTMLScriptElement>("script[data-object]")].map((script) => ({
    name: script.dataset.object!,
    read: () => fromBase64(script.textContent ?? "").buffer,
  }));
}

/** Call a function with the files that are chosen or dropped on the page. */
export function whenOpened(chooser: HTMLInputElement, call: (files: Source[]) => void): void {
  const open = (files: FileList | null | undefined) => {
    if (files?.length)
      call(
        [...files].map((file) => ({
          name: file.name.replace(/\.safetensors$/, ""),
          read: () => file.arrayBuffer(),
        })),
      );
  };
  chooser.addEventListener("change", () => {
    open(chooser.files);
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
    open(event.dataTransfer?.files);
  });
}
