// The list of emulators the page can show.

import { fetchOwn } from "../server/token";

export interface CatalogueEntry {
  readonly id: string;
  readonly system: string;
  /** Its title, if there are several of one system. */
  readonly title?: string;
  readonly about: string;
  /** The bundle's folder, relative to the page. */
  readonly bundle: string;
}

export interface Catalogue {
  readonly version: string;
  readonly has_server: boolean;
  /** Shipped systems, which need no model of the user's. */
  readonly systems: readonly string[];
  readonly entries: readonly CatalogueEntry[];
}

/** Fetch the catalogue that lies beside the page. */
export async function loadCatalogue(page: URL): Promise<Catalogue> {
  const response = await fetchOwn(new URL("catalogue.json", page));
  return (await response.json()) as Catalogue;
}

/** Return the folder of an entry's bundle. */
export function bundleFolder(entry: CatalogueEntry, page: URL): URL {
  const folder = entry.bundle.endsWith("/") ? entry.bundle : `${entry.bundle}/`;
  return new URL(folder, page);
}
