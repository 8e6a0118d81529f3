/** Objects that the page holds, and files that its reader opens. */

/** Object Files as base64, by name: in script elements of the page, or set by scripts beside it. */
export interface Embedded {
  name: string;
  read(): ArrayBuffer;
}

function bytes(text: string): ArrayBuffer {
  const raw = atob(text.trim());
  const out = new Uint8Array(raw.length);
  for (let n = 0; n < raw.length; n++) out[n] = raw.charCodeAt(n);
  return out.buffer;
}

export function embedded(): Embedded[] {
  return [...document.querySelectorAll<HTMLScriptElement>("script[data-object]")].map((script) => ({
    name: script.dataset.object!,
    read: () => bytes(script.textContent ?? ""),
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
