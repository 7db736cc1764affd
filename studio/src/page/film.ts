// Films: pictures of a canvas at a constant rate, however long each took to draw, encoded by the browser.

import {
  BufferTarget,
  CanvasSource,
  getFirstEncodableVideoCodec,
  Mp4OutputFormat,
  Output,
  QUALITY_HIGH,
  WebMOutputFormat,
} from "mediabunny";

/** Width and height of a picture [pixels]. */
export const FILM_SIZE = { width: 1280, height: 720 } as const;

/** Frame rate [pictures per second]. */
export const FILM_RATE = 30;

/** Codecs by preference: H.264 plays everywhere, but not every browser may encode it. */
const CODECS = ["avc", "vp9", "av1", "vp8"] as const;

export interface Film {
  readonly blob: Blob;
  /** Suffix of its file, with a dot. */
  readonly ending: string;
}

export interface FilmOptions {
  /** A canvas of `FILM_SIZE`. */
  readonly canvas: HTMLCanvasElement;
  /** Number of pictures. */
  readonly pictures: number;
  /** Draws a picture on the canvas; the first is 0. */
  draw(picture: number): void;
  /** Called with the share of pictures done, 0 to 1. */
  onProgress(share: number): void;
  readonly signal: AbortSignal;
}

/** Return the film: MP4 if the browser encodes H.264, else WebM. Throws an Error of one line, or the signal's reason. */
export async function makeFilm({ canvas, pictures, draw, onProgress, signal }: FilmOptions): Promise<Film> {
  const codec = await getFirstEncodableVideoCodec([...CODECS], { ...FILM_SIZE, quality: QUALITY_HIGH });
  if (!codec) {
    throw new Error("This browser cannot encode films here: open the page in a recent Chromium, Firefox or Safari, on this machine or over https.");
  }
  const format = codec === "avc" ? new Mp4OutputFormat() : new WebMOutputFormat();
  const target = new BufferTarget();
  const output = new Output({ format, target });
  const source = new CanvasSource(canvas, { codec, quality: QUALITY_HIGH });
  output.addVideoTrack(source, { frameRate: FILM_RATE });
  try {
    await output.start();
    for (let picture = 0; picture < pictures; picture++) {
      draw(picture);
      // The canvas is read before this returns: later the browser may have cleared it.
      await source.add(picture / FILM_RATE, 1 / FILM_RATE);
      onProgress((picture + 1) / pictures);
      await breathe();
      signal.throwIfAborted();
    }
    await output.finalize();
  } catch (error) {
    await output.cancel();
    throw error;
  }
  return { blob: new Blob([target.buffer!], { type: format.mimeType }), ending: format.fileExtension };
}

/** Let the browser draw the page and handle events. Timers would take a second each in a background window. */
function breathe(): Promise<void> {
  return new Promise((resume) => {
    const { port1, port2 } = new MessageChannel();
    port1.onmessage = () => {
      port1.close();
      resume();
    };
    port2.postMessage(null);
  });
}
