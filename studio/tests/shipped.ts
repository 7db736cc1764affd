// Files of the bundles that ship, for tests in Node.

import { readFile } from "node:fs/promises";

const BUNDLES = new URL("../neuroanimator_studio/bundles/", import.meta.url);

/** Return the bytes of a shipped file, such as fish-50/bundle.json. */
export async function shippedFile(path: string): Promise<Uint8Array<ArrayBuffer>> {
  const bytes = await readFile(new URL(path, BUNDLES));
  return new Uint8Array(bytes);
}
