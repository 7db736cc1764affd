// Sources of controls while the emulator runs live: sliders, commands to a policy, a target to swim to.

import { commandToward, rootPose, unit, type Vector } from "../body/root";
import type { Bundle, GaitFacts } from "../bundle/bundle";
import type { CommandedPolicy, Policy } from "../emulator/policy";
import type { Pilot } from "../motion/player";
import { Falls } from "./fall";

/** Maximum turn and climb in a command to a swimmer sent to a target [rad], as in behaviours. */
const MAX_TURN = 0.8;
const MAX_CLIMB = 0.5;

/** Speed of a body sent to a target, over the fastest of its policy. */
const CRUISE = 0.6;

/** Holds the controls of the sliders. */
export class SliderPilot implements Pilot {
  readonly values: number[];

  constructor(facts: Bundle) {
    this.values = neutralControl(facts);
  }

  control(): number[] {
    return this.values;
  }
}

/** Return the control nearest to zero within its bounds. */
export function neutralControl(facts: Bundle): number[] {
  return facts.control_low.map((low, i) => Math.min(Math.max(0, low), facts.control_high[i]!));
}

/** Moves by the body's own gait. */
export class GaitPilot implements Pilot {
  constructor(
    private readonly facts: Bundle,
    private readonly gait: GaitFacts,
  ) {}

  control(_state: Float32Array, step: number): number[] {
    const { control_low: lows, control_high: highs, dt } = this.facts;
    const phase = (2 * Math.PI * (step + 0.5) * dt) / this.gait.period;
    return neutralControl(this.facts).map((idle, i) => {
      const low = lows[i]!;
      const high = highs[i]!;
      const wave = this.gait.amplitudes[i]! * Math.sin(phase - this.gait.lags[i]!);
      return clamp(idle + wave * Math.max(high - idle, idle - low), low, high);
    });
  }
}

/** Swims by commands to a policy; without any, straight ahead and level. */
export class PolicyPilot implements Pilot {
  /** Speed [m/s], and angles to turn left and to climb [rad]; the roll is kept at zero. */
  readonly command = { speed: 0, turn: 0, climb: 0 };
  /** Target to swim to instead [m], if any. */
  target: Vector | null = null;

  constructor(
    private readonly policy: Policy,
    private readonly facts: Bundle,
  ) {
    this.command.speed = CRUISE * this.maxSpeed;
  }

  /** Fastest speed of the policy [m/s]. */
  get maxSpeed(): number {
    return this.facts.policy!.command[0]![3];
  }

  control(state: Float32Array, step: number): Float32Array {
    const phase = (step * this.facts.policy!.phase_per_step!) % (2 * Math.PI);
    const limits = this.facts.policy!.command;
    const bounded = this.#wanted(state).map((value, i) => clamp(value, limits[i]![2], limits[i]![3]));
    return this.policy.control(state, phase, bounded);
  }

  #wanted(state: Float32Array): number[] {
    const root = this.facts.root;
    if (!root) {
      return [this.command.speed, this.command.turn, this.command.climb, 0];
    }
    const pose = rootPose(root, state);
    if (!this.target) {
      const level = Math.asin(clamp(-pose.forward[2], -1, 1));
      const climb = this.command.climb === 0 ? 0.7 * level : this.command.climb;
      return [this.command.speed, this.command.turn, climb, -pose.roll];
    }
    return seek(pose, this.target, this.command.speed);
  }
}

/** Walks by commands that are in its state. */
export class WalkPilot implements Pilot {
  /** Speed [m/s], and turn rate to the left [rad/s]. */
  readonly command = { speed: 0, turning: 0 };
  readonly #falls: Falls;

  constructor(
    private readonly policy: CommandedPolicy,
    private readonly facts: Bundle,
  ) {
    const { low, high } = this.speeds;
    this.command.speed = (low + high) / 2;
    this.#falls = new Falls(facts);
  }

  /** Slowest and fastest speed of the policy [m/s]. */
  get speeds(): { readonly low: number; readonly high: number } {
    return this.#range(0);
  }

  /** Fastest turn rates to the right and to the left [rad/s]. */
  get turnings(): { readonly low: number; readonly high: number } {
    return this.#range(1);
  }

  told(state: Float32Array): Float32Array {
    return this.#commanded(state).state;
  }

  control(state: Float32Array): Float32Array {
    return this.#commanded(state).control;
  }

  /** Whether the body has lost its balance, and is falling or getting up. */
  get isFalling(): boolean {
    return this.#falls.isFalling;
  }

  instead(state: Float32Array, next: Float32Array, score: number): Float32Array | null {
    return this.#falls.instead(state, next, score);
  }

  #commanded(state: Float32Array): ReturnType<CommandedPolicy["control"]> {
    return this.policy.control(state, [this.command.speed, this.command.turning]);
  }

  #range(number: number): { readonly low: number; readonly high: number } {
    const [, , low, high] = this.facts.policy!.command[number]!;
    return { low, high };
  }
}

/** Return the command that leads to a target [m] without steep dives and sharp turns. */
export function seek(pose: ReturnType<typeof rootPose>, target: Vector, speed: number): number[] {
  const offset: Vector = [
    target[0] - pose.position[0],
    target[1] - pose.position[1],
    target[2] - pose.position[2],
  ];
  const level = Math.max(Math.hypot(offset[0], offset[1]), 1e-6);
  const heading = Math.atan2(pose.forward[1], pose.forward[0]);
  let turn = Math.atan2(offset[1], offset[0]) - heading;
  turn -= 2 * Math.PI * Math.round(turn / (2 * Math.PI));
  const newHeading = heading + clamp(turn, -MAX_TURN, MAX_TURN);
  const climb = clamp(Math.atan2(offset[2], level), -MAX_CLIMB, MAX_CLIMB);
  const direction = unit([Math.cos(newHeading), Math.sin(newHeading), Math.tan(climb)]);
  return commandToward(pose, direction, speed);
}

export function clamp(value: number, low: number, high: number): number {
  return Math.min(Math.max(value, low), high);
}
