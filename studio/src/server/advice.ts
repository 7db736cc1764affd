// What to do where a page has no server, or a server no physics.

import type { Live } from "./live";

/** Where a page with a server comes from. */
const WITH_SERVER = "a page that 'neuroanimator studio' opens on your own machine has one";

/** Return why there is no physics beside an emulator. */
export function sayNoPhysics(live: Live | null): string {
  return live
    ? "There is no physics of this system here: the server has not the files of its model."
    : `The physics of this system is computed by a server, which this page has not; ${WITH_SERVER}.`;
}

/** Return why `what` cannot be done by a page without a server. */
export function sayNoServer(what: string): string {
  return `${what} by a server, which this page has not; ${WITH_SERVER}.`;
}
