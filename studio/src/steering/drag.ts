// A mover of a soft body, dragged by mouse or finger: it follows the pointer as fast as it may.

import type { MoverFacts } from "../bundle/bundle";
import type { Grabbable } from "../page/pointer";
import type { Session } from "../page/session";
import { makeKnob, makePathLine, TARGET_COLOUR, type Knob, type PathLine } from "../scene/handle";
import type { MoverPilot } from "./movers";

/** Displacement away from the eye per notch of the wheel, over the body's size. */
const NOTCH = 0.05;

/** Size of a notch in browsers [pixels]. */
const NOTCH_PIXELS = 100;

export class MoverDrag implements Grabbable {
  readonly #bones: number[];
  /** Knobs of invisible movers, by their bones. */
  readonly #knobs: { readonly bone: number; readonly knob: Knob }[] = [];
  readonly #line: PathLine;
  #held: number | null = null;
  /** Target of the mover, and the pointer's offset from it [m]. */
  #target: [number, number, number] = [0, 0, 0];
  #grip: number[] = [0, 0, 0];

  constructor(
    private readonly session: Session,
    private readonly pilot: MoverPilot,
    private readonly goLive: () => void,
  ) {
    const { facts, world } = session;
    this.#bones = facts.movers!.map((mover) => boneOf(session, mover));
    const strikes = this.#bones.findIndex((bone) => facts.skeleton[bone]!.shapes.length > 0);
    pilot.chosen = Math.max(strikes, 0);
    for (const bone of this.#bones.filter((one) => facts.skeleton[one]!.shapes.length === 0)) {
      const knob = makeKnob(world.size);
      world.add(knob.object);
      this.#knobs.push({ bone, knob });
    }
    this.#line = makePathLine(TARGET_COLOUR, 0.9, 2);
    this.#line.object.visible = false;
    world.add(this.#line.object);
  }

  grab(x: number, y: number): boolean {
    const { world } = this.session;
    const grip = world.pickMover(x, y, this.#bones);
    if (!grip) {
      return false;
    }
    this.#held = this.#bones.indexOf(grip.bone);
    world.isCameraHeld = true;
    this.#target = world.bonePoint(grip.bone);
    this.#grip = grip.point.map((value, axis) => value - this.#target[axis]!);
    return true;
  }

  drag(x: number, y: number, isLevel: boolean): void {
    const point = this.#target.map((value, axis) => value + this.#grip[axis]!);
    const place = this.session.world.dragPoint(x, y, point, isLevel);
    if (place) {
      this.#lead(place.map((value, axis) => value - this.#grip[axis]!));
    }
  }

  wheel(pixels: number): void {
    const { world } = this.session;
    const away = world.lookingAlong;
    const distance = (-pixels / NOTCH_PIXELS) * NOTCH * world.size;
    this.#lead(this.#target.map((value, axis) => value + distance * away[axis]!));
  }

  release(): void {
    this.#held = null;
    this.session.world.isCameraHeld = false;
    this.#line.object.visible = false;
    this.pilot.release();
  }

  /** Draw the knobs, and the line from the held mover to the pointer. */
  update(): void {
    const { world } = this.session;
    this.#knobs.forEach(({ bone, knob }) => knob.moveTo(world.bonePoint(bone)));
    if (this.#held !== null) {
      this.#line.show([...world.bonePoint(this.#bones[this.#held]!), ...this.#target]);
    }
  }

  dispose(): void {
    const { world } = this.session;
    for (const { knob } of this.#knobs) {
      world.remove(knob.object);
      knob.dispose();
    }
    world.remove(this.#line.object);
    this.#line.dispose();
  }

  #lead(place: ArrayLike<number>): void {
    const { player } = this.session;
    this.#target = [place[0]!, place[1]!, place[2]!];
    this.pilot.lead(this.#held!, this.#target);
    this.#line.object.visible = true;
    player.pilot = this.pilot;
    // Physics that has taken over is led, too.
    if (!player.isLive && !player.isHeld) {
      this.goLive();
    }
    player.isPlaying = true;
  }
}

/** Return the number of a mover's bone. */
function boneOf({ facts }: Session, [name, entry]: MoverFacts): number {
  const bone = facts.skeleton.findIndex((one) => one.joints[0]?.entry === entry);
  if (bone < 0) {
    throw new Error(`no bone goes with the mover '${name}'`);
  }
  return bone;
}
