/** Elements of the page by their names. */

export function element<T extends HTMLElement>(id: string): T {
  const found = document.getElementById(id);
  if (!found) throw new Error(`the page lacks #${id}`);
  return found as T;
}

export const input = (id: string): HTMLInputElement => element<HTMLInputElement>(id);
export const select = (id: string): HTMLSelectElement => element<HTMLSelectElement>(id);
export const canvas = (id: string): HTMLCanvasElement => element<HTMLCanvasElement>(id);

/** Show a text, or hide the element if there is none. */
export function tell(id: string, text: string | null): void {
  const place = element(id);
  place.hidden = text === null;
  place.textContent = text ?? "";
}

/** Fill a menu. */
export function options(id: string, entries: [value: string, label: string][], chosen?: string): void {
  select(id).replaceChildren(
    ...entries.map(([value, label]) => new Option(label, value, value === chosen, value === chosen)),
  );
}

/** Save a file by the browser. */
export function save(content: Blob, name: string): void {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(content);
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 1000);
}

/** Call a function when one of some controls changes, and once for each before. */
export function whenever(ids: string[], event: "input" | "change", call: () => void): void {
  for (const id of ids) element(id).addEventListener(event, call);
}
