// "Reach a goal": where descent through the emulator finds controls. What it may use of the page is its context.

import type { LoadedBundle } from "../bundle/bundle";
import type { Emulator } from "../emulator/emulator";
import type { Player } from "../motion/player";
import { element } from "../page/dom";
import type { Banners } from "../page/banner";
import type { World } from "../scene/world";
import type { Live } from "../server/live";

export interface SynthesisContext {
  readonly bundle: LoadedBundle;
  readonly emulator: Emulator;
  readonly player: Player;
  readonly world: World;
  /** The line to the server, or null where there is none. */
  readonly live: Live | null;
  readonly banners: Banners;
  /** The body of the panel, empty: fill it. */
  readonly body: HTMLElement;
}

export interface Synthesis {
  /** Called once an image. */
  update(seconds: number): void;
  /** A pointer went down at x, y (-1 to 1 across the picture, and up); return true to have its drag. */
  grab(x: number, y: number): boolean;
  /** The pointer that was grabbed moved, or went up. */
  drag(x: number, y: number): void;
  release(): void;
  dispose(): void;
}

/** Fill the panel for the system on the stage. */
export function makeSynthesis(context: SynthesisContext): Synthesis {
  const goals = context.bundle.facts.goals.map((goal) => goal.name).join(", ");
  context.body.append(element("p", "", [`Goals of this system: ${goals || "none"}.`]));
  return {
    update: () => undefined,
    grab: () => false,
    drag: () => undefined,
    release: () => undefined,
    dispose: () => undefined,
  };
}
