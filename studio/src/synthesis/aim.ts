// The goal: the values that can be moved, a handle in the scene for a place, and sliders for the rest.

import { quaternionHeading } from "../body/heading";
import type { Goal, LoadedBundle } from "../bundle/bundle";
import { element, slider, type Slider } from "../page/dom";
import { makeTarget, type TargetHandle } from "../scene/handle";
import type { World } from "../scene/world";
import type { DescentFacts, Movable } from "./facts";

export class Aim {
  readonly element = element("div", "aim");
  /** Called when something has been moved and released. */
  onChange: () => void = () => undefined;

  readonly #values: Record<string, number[]> = {};
  readonly #sliders = new Map<string, Slider>();
  readonly #place: Movable | undefined;
  readonly #handle: TargetHandle | null = null;
  #isHeld = false;

  constructor(
    readonly facts: DescentFacts,
    private readonly bundle: LoadedBundle,
    private readonly world: World,
  ) {
    for (const movable of facts.movable) {
      this.#values[movable.name] = [...movable.value];
    }
    this.#place = facts.movable.find((movable) => movable.kind === "place");
    if (this.#place) {
      this.#handle = makeTarget(world.size, this.#within());
      this.#handle.moveTo(this.#place.value);
      world.add(this.#handle.object);
    }
    this.#addGoals();
    facts.movable.forEach((movable) => this.#addSlider(movable));
  }

  /** A copy of all values by name. */
  get values(): Record<string, number[]> {
    return structuredClone(this.#values);
  }

  /** Move everything to `values`, without calling `onChange`. */
  restore(values: Readonly<Record<string, readonly number[]>>): void {
    for (const [name, value] of Object.entries(values)) {
      this.#set(name, value);
    }
  }

  /** Displace the place from its initial position [m], with a body that starts elsewhere. */
  shift(by: readonly number[]): void {
    const place = this.#place;
    if (place) {
      this.#set(place.name, place.value.map((number, axis) => number + by[axis]!));
    }
  }

  /** Return whether the pointer grabbed the handle. */
  grab(x: number, y: number): boolean {
    this.#isHeld = this.#handle !== null && this.world.isNear(x, y, this.#handle.place);
    return this.#isHeld;
  }

  drag(x: number, y: number): void {
    const place = this.#place;
    if (!place || !this.#handle || !this.#isHeld) {
      return;
    }
    const isLevel = place.low[2] === place.high[2];
    const to = this.world.dragPoint(x, y, this.#handle.place, isLevel);
    if (to) {
      // A place on the ground stays there.
      const height = isLevel ? place.low[2]! : to[2];
      this.#set(place.name, [to[0], to[1], height]);
    }
  }

  release(): void {
    if (this.#isHeld) {
      this.#isHeld = false;
      this.onChange();
    }
  }

  dispose(): void {
    if (this.#handle) {
      this.world.remove(this.#handle.object);
      this.#handle.dispose();
    }
  }

  /** Tolerance [m], if the goal has one. */
  #within(): number | undefined {
    for (const goal of this.bundle.facts.goals) {
      if ("distance" in goal.within) {
        return goal.within.distance;
      }
    }
    return undefined;
  }

  #set(name: string, value: readonly number[]): void {
    this.#values[name] = [...value];
    const place = this.#place;
    if (name === place?.name) {
      this.#handle?.moveTo(value);
      this.world.moveGoalPaint(value.map((number, axis) => number - place.value[axis]!));
    }
    const shown = this.#sliders.get(name);
    if (shown) {
      const movable = this.facts.movable.find((one) => one.name === name)!;
      shown.value = value[0]! * scaleOf(movable);
    }
  }

  #addSlider(movable: Movable): void {
    if (movable.kind === "place") {
      return;
    }
    const scale = scaleOf(movable);
    const isHeading = movable.kind === "heading";
    const made = slider({
      label: isHeading ? movable.name : `${movable.name} cost`,
      unit: isHeading ? movable.unit : "×",
      low: movable.low[0]! * scale,
      high: movable.high[0]! * scale,
      value: movable.value[0]! * scale,
      onInput: (value) => {
        this.#values[movable.name] = [value / scale];
      },
    });
    made.row.addEventListener("change", () => this.onChange());
    this.#sliders.set(movable.name, made);
    this.element.append(made.row);
  }

  // The system's own named places, to choose from if there are several.
  #addGoals(): void {
    const place = this.#place;
    const named = this.bundle.facts.goals.filter((goal) => goal.target !== null && goal.movable?.entry !== null && goal.movable);
    if (!place || named.length < 2) {
      return;
    }
    const choice = element("select");
    choice.setAttribute("aria-label", "Where to");
    choice.append(element("option", "", ["Where to …"]), ...named.map((goal) => element("option", "", [goal.name])));
    choice.addEventListener("change", () => {
      const goal = named[choice.selectedIndex - 1];
      if (goal) {
        this.#moveToGoal(place, goal);
        this.onChange();
      }
    });
    this.element.append(choice);
  }

  #moveToGoal(place: Movable, goal: Goal): void {
    this.#set(place.name, goal.movable!.at);
    const root = this.bundle.facts.root;
    const heading = this.facts.movable.find((movable) => movable.kind === "heading");
    if (heading && root?.kind === "free" && goal.target) {
      this.#set(heading.name, [quaternionHeading(goal.target.slice(root.orientation, root.orientation + 4))]);
    }
  }
}

/** Return the factor of a value on its slider: weights are relative to their initial values. */
function scaleOf(movable: Movable): number {
  return movable.kind === "heading" ? 1 : 1 / movable.value[0]!;
}
