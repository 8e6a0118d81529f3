/** What objectfolder/report/facts.py writes. */

/** Path in the metrics, title, unit (`measure` in dom.ts), whether more is better. */
export type Score = [name: string, title: string, unit: string, more: boolean];

export interface Row {
  key: string;
  material: string;
  size: number | null;
  /** Whether it has no page: it is not built or, if a check failed, cannot be read. */
  missing?: boolean;
  modes?: number;
  lowest?: number | null;
  bytes?: number;
  failed: string[];
  warnings: string[];
  scores: Record<string, number>;
  thumbnail?: string;
}

export interface Strip {
  title: string;
  score?: number;
  source: string;
}

export interface Detail {
  key: string;
  checks: { name: string; figure: string; limit: string; passed: boolean }[];
  modes: (number | null)[][];
  views: Strip[];
  /** `axes`: what the spectrogram spans. */
  sounds: (Strip & { axes: string; truth: string | null; answer: string })[];
  touches: Strip[];
  provenance: Record<string, string>;
  /** Stage, processor seconds, wall seconds, peak MB. */
  costs: [string, number, number, number][];
  file: string;
}

export interface Data {
  rows: Row[];
  scores: Score[];
  /** Page of the live viewer, with {{title}}, {{objects}} and {{script}} to fill in. */
  frame: string;
}

declare global {
  interface Window {
    objectfolderReport: (detail: Detail) => void;
    objectfolderViewer: (program: string) => void;
  }
}

function json<T>(id: string): T {
  return JSON.parse(document.getElementById(id)!.textContent!) as T;
}

export const data = json<Data>("data");

/** What a script beside the page brings, by its path. */
const waiting = new Map<string, (brought: never) => void>();

window.objectfolderReport = (detail) => waiting.get(`objects/${detail.key}.js`)?.(detail as never);
window.objectfolderViewer = (program) => waiting.get("viewer.js")?.(program as never);

/** Return what a script beside the page brings: from disk, pages may load no data. */
function beside<T>(path: string): Promise<T> {
  return new Promise((resolve, reject) => {
    const script = document.createElement("script");
    script.src = path;
    const done = () => {
      waiting.delete(path);
      script.remove();
    };
    waiting.set(path, (brought: T) => {
      done();
      resolve(brought);
    });
    script.onerror = () => {
      done();
      reject(new Error(`${path} is missing: copy the whole folder of the report`));
    };
    script.onload = () => {
      if (!waiting.has(path)) return;
      done();
      reject(new Error(`${path} is damaged: write the report again, or copy it again`));
    };
    document.head.append(script);
  });
}

/** Return the program of the live viewer: from the page, or from a script beside it. */
export const viewerProgram = async () => json<string | null>("viewer") ?? (await beside<string>("viewer.js"));

/** Return what the report says of an object: from the page, or from a script beside it. */
export function detailOf(key: string): Promise<Detail> {
  const held = document.querySelector(`script[data-report="${key}"]`);
  if (held) return Promise.resolve(JSON.parse(held.textContent!) as Detail);
  return beside<Detail>(`objects/${key}.js`);
}
