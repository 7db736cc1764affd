// Sticks on the stage for fingers: they hold the keys that steer, where there is no keyboard.

import { element } from "./dom";
import type { STEERING_KEYS } from "./keyboard";

type Key = (typeof STEERING_KEYS)[number];

/** Displacement of a stick from which a key counts as held, over its reach. */
const HELD = 0.35;

/** A stick's keys: to the right, left, up and down. */
type Keys = readonly [right: Key | null, left: Key | null, up: Key, down: Key];

const ARROWS: Keys = ["ArrowRight", "ArrowLeft", "ArrowUp", "ArrowDown"];
const PAGES: Keys = [null, null, "PageUp", "PageDown"];

export interface Sticks {
  readonly element: HTMLElement;
  /** Show what each stick steers, in a few words; null hides it. */
  label(arrows: string | null, pages: string | null): void;
}

/** Return the sticks, hidden by the page's style where a mouse is; they add to and take from the keys `held`. */
export function makeSticks(held: Set<string>): Sticks {
  const first = makeStick(ARROWS, held);
  const second = makeStick(PAGES, held);
  return {
    element: element("div", "sticks", [first.element, second.element]),
    label(arrows, pages) {
      first.label(arrows);
      second.label(pages);
    },
  };
}

function makeStick(keys: Keys, held: Set<string>): { element: HTMLElement; label(words: string | null): void } {
  const knob = element("span", "knob");
  const base = element("div", "stick", [knob]);
  base.setAttribute("role", "group");
  const move = (x: number, y: number): void => {
    const isHeld = [x > HELD, x < -HELD, y > HELD, y < -HELD];
    keys.forEach((key, i) => {
      if (key && isHeld[i]) {
        held.add(key);
      } else if (key) {
        held.delete(key);
      }
    });
    knob.style.translate = `${100 * x}% ${-100 * y}%`;
  };
  const place = (event: PointerEvent): void => {
    const box = base.getBoundingClientRect();
    const reach = box.width / 2;
    const x = keys[0] ? (event.clientX - box.left) / reach - 1 : 0;
    const y = 1 - (2 * (event.clientY - box.top)) / box.height;
    const far = Math.max(Math.hypot(x, y), 1);
    move(x / far, y / far);
  };
  base.addEventListener("pointerdown", (event) => {
    event.preventDefault();
    base.setPointerCapture(event.pointerId);
    place(event);
  });
  base.addEventListener("pointermove", (event) => {
    if (base.hasPointerCapture(event.pointerId)) {
      place(event);
    }
  });
  for (const end of ["pointerup", "pointercancel", "lostpointercapture"] as const) {
    base.addEventListener(end, () => move(0, 0));
  }
  return {
    element: base,
    label(words) {
      base.hidden = words === null;
      base.setAttribute("aria-label", words ?? "");
      base.dataset["words"] = words ?? "";
    },
  };
}
