// Actions of all keys: one table, by the names in `Keyboard`.

import type { Player } from "../motion/player";
import type { Timeline } from "../panels/timeline";
import type { CameraRig } from "../scene/cameras";
import type { Showing } from "./showing";

/** Number of systems with a number key. */
const NUMBER_KEYS = 9;

/** What keys act on; null until it exists. */
export interface Workplace {
  readonly showing: Showing | null;
  readonly timeline: Timeline | null;
  pick(number: number): void;
  nextCamera(): void;
  help(): void;
}

/** Return the actions of all keys. */
export function shortcuts(place: Workplace): Record<string, () => void> {
  const withShowing = (act: (showing: Showing) => void) => () => {
    if (place.showing) {
      act(place.showing);
    }
  };
  const withPlayer = (act: (player: Player) => void) => withShowing((showing) => act(showing.session.player));
  const withCamera = (act: (camera: CameraRig) => void) => withShowing((showing) => act(showing.session.world.camera));
  const numbers = Array.from({ length: NUMBER_KEYS }, (_, i) => [String(i + 1), () => place.pick(i)] as const);
  return {
    ...Object.fromEntries(numbers),
    " ": () => place.timeline?.toggle(),
    ",": withPlayer((player) => player.stepBy(-1)),
    ".": withPlayer((player) => player.stepBy(1)),
    Home: withPlayer((player) => player.seek(0)),
    End: withPlayer((player) => player.seek(player.motion.duration)),
    "[": () => place.timeline?.changeSpeed(-1),
    "]": () => place.timeline?.changeSpeed(1),
    l: withShowing((showing) => showing.goLive()),
    r: withShowing((showing) => showing.restart()),
    g: withShowing((showing) => showing.toggleGhost()),
    t: withShowing((showing) => showing.toggleTarget()),
    c: () => place.nextCamera(),
    h: withShowing((showing) => showing.session.world.home()),
    "Shift+ArrowLeft": withCamera((camera) => camera.keyTurn(1, 0)),
    "Shift+ArrowRight": withCamera((camera) => camera.keyTurn(-1, 0)),
    "Shift+ArrowUp": withCamera((camera) => camera.keyTurn(0, 1)),
    "Shift+ArrowDown": withCamera((camera) => camera.keyTurn(0, -1)),
    "+": withCamera((camera) => camera.keyZoom(true)),
    "=": withCamera((camera) => camera.keyZoom(true)),
    "-": withCamera((camera) => camera.keyZoom(false)),
    "Ctrl+z": withShowing((showing) => showing.undo()),
    "?": () => place.help(),
  };
}
