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
  }
}

function json<T>(id: string): T {
  return JSON.parse(document.getElementById(id)!.textContent!) as T;
}

export const data = json<Data>("data");

/** The program of the live viewer in a single page; null if it lies beside the page. */
export const viewerScript = () => json<string | null>("viewer");

const waiting = new Map<string, (detail: Detail) => void>();

window.objectfolderReport = (detail) => waiting.get(detail.key)?.(detail);

/** Return what the report says of an object: from the page, or from a script beside it. */
export function detailOf(key: string): Promise<Detail> {
  const held = document.querySelector(`script[data-report="${key}"]`);
  if (held) return Promise.resolve(JSON.parse(held.textContent!) as Detail);
  return new Promise((resolve, reject) => {
    const script = document.createElement("script");
    script.src = `objects/${key}.js`;
    const done = () => {
      waiting.delete(key);
      script.remove();
    };
    waiting.set(key, (detail) => {
      done();
      resolve(detail);
    });
    script.onerror = () => {
      done();
      reject(new Error(`objects/${key}.js is missing: copy the whole folder of the report`));
    };
    script.onload = () => {
      if (!waiting.has(key)) return;
      done();
      reject(new Error(`objects/${key}.js is damaged: write the report again, or copy it again`));
    };
    document.head.append(script);
  });
}
