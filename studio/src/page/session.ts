// One system on the stage: its emulator, player, world and pilots.

import { rootPose } from "../body/root";
import { isWalking, loadBundle, type Bundle, type LoadedBundle } from "../bundle/bundle";
import { bundleFolder, type CatalogueEntry } from "../bundle/catalogue";
import { sizeOf } from "../bundle/layout";
import { Emulator } from "../emulator/emulator";
import { fetchModule } from "../emulator/instance";
import { CommandedPolicy, Policy } from "../emulator/policy";
import { Player } from "../motion/player";
import { World } from "../scene/world";
import type { Stage } from "../scene/stage";
import { GaitPilot, PolicyPilot, SliderPilot, WalkPilot } from "../steering/pilots";
import { Crowd } from "../steering/crowd";
import { Life, POPULATION, SMALL } from "../steering/life";
import { MoverPilot, WanderPath } from "../steering/movers";
import { School } from "../steering/school";
import { Walkers } from "../steering/walkers";

/** Time for the browser to show the page's text, before a new stage keeps it busy [ms]. */
const PAINTING = 30;

/** Number of super steps that measure the emulator's speed. */
const TIMED_STEPS = 200;

export class Session {
  readonly player: Player;
  readonly sliders: SliderPilot;
  readonly swimmer: PolicyPilot | null;
  readonly walker: WalkPilot | null;
  /** The pilot of a soft body's movers, and the paths they wander along. */
  readonly movers: { readonly pilot: MoverPilot; readonly path: WanderPath } | null;
  /** Time of a super step of the emulator [s], measured when it was loaded. */
  readonly secondsPerStep: number;
  readonly world: World;
  school: School | null = null;
  /** The small fish around this one, if they are shown. */
  life: Life | null = null;
  crowd: Crowd | null = null;
  /** Others who walk around this one, if they are shown. */
  walkers: Walkers | null = null;
  #wantedCrowd = 0;
  #wantedWalkers = 0;

  private constructor(
    readonly entry: CatalogueEntry,
    readonly bundle: LoadedBundle,
    readonly emulator: Emulator,
    private readonly policy: Policy | CommandedPolicy | null,
    private readonly emulatorModule: WebAssembly.Module,
    stage: Stage,
    isDark: boolean,
  ) {
    const facts = bundle.facts;
    this.player = new Player(emulator, facts);
    this.sliders = new SliderPilot(facts);
    this.swimmer = policy instanceof Policy ? new PolicyPilot(policy, facts) : null;
    this.walker = policy instanceof CommandedPolicy ? new WalkPilot(policy, facts) : null;
    this.movers = null;
    if (facts.surface && facts.movers?.length) {
      const path = new WanderPath(this.player.motion, facts);
      this.movers = { path, pilot: new MoverPilot(facts, path) };
    }
    // A cloth would jump where its motion restarts; a walker only has the motion of its policy.
    this.player.goesOn = this.movers !== null || this.walker !== null;
    const gait = facts.gait ? new GaitPilot(facts, facts.gait) : null;
    this.player.pilot = this.swimmer ?? this.walker ?? this.movers?.pilot ?? gait ?? this.sliders;
    this.secondsPerStep = timeSteps(emulator, facts);
    this.world = new World(stage, facts, this.player.motion.state(0), isDark);
  }

  /** Load an emulator; null if it is no longer wanted once loaded. The error is one clear line. */
  static async open(
    entry: CatalogueEntry,
    page: URL,
    stage: Stage,
    isDark: boolean,
    isWanted: () => boolean,
  ): Promise<Session | null> {
    const bundle = await loadBundle(bundleFolder(entry, page));
    const { facts, folder } = bundle;
    const state = sizeOf(facts.state);
    const control = sizeOf(facts.control);
    const sizes = { state, control, latent: facts.latent };
    const [emulatorModule, policyModule] = await Promise.all([
      fetchModule(new URL(facts.emulator, folder)),
      facts.policy ? fetchModule(new URL(facts.policy.wasm, folder)) : null,
      new Promise((resume) => setTimeout(resume, PAINTING)),
    ]);
    const emulator = await Emulator.start(emulatorModule, sizes);
    const policy = policyModule && (await startPolicy(policyModule, facts));
    // The stage is for the system requested last, whichever arrives last.
    if (!isWanted()) {
      return null;
    }
    return new Session(entry, bundle, emulator, policy, emulatorModule, stage, isDark);
  }

  get facts(): Bundle {
    return this.bundle.facts;
  }

  /** Show a school of `count` more of its kind around the body; 0 removes it. */
  async keepSchool(count: number): Promise<void> {
    this.world.showSchool(null);
    this.school = null;
    this.life = null;
    if (count === 0 || !(this.policy instanceof Policy) || !this.facts.root) {
      return;
    }
    // A separate module: its memory is freed with the school.
    const emulator = await Emulator.start(this.emulatorModule, this.emulator.sizes);
    const { world } = this;
    this.school = new School(emulator, this.policy, this.facts, world.size, world.room, world.middle, count);
    world.showSchool(this.school);
  }

  /** Whether small fish can live around this body: it must be a fish that a policy steers. */
  get canLive(): boolean {
    return this.facts.system === "fish" && this.policy instanceof Policy && this.facts.root !== null;
  }

  /** Let small fish live around this one, which is their shark. */
  async keepLife(): Promise<void> {
    await this.keepSchool(0);
    const { facts, world, player } = this;
    const root = facts.root!;
    const emulator = await Emulator.start(this.emulatorModule, this.emulator.sizes);
    const room = { low: world.room.low / SMALL, high: world.room.high / SMALL };
    const centre = world.ahead(3.5, 0).map((value) => value / SMALL) as [number, number, number];
    const school = new School(emulator, this.policy as Policy, facts, world.size, room, centre, POPULATION);
    this.life = new Life(school, centre, facts.dt, world.size, () => rootPose(root, player.state()), world.room.low);
    world.showLife(this.life);
  }

  /** Drop food at the pointer, if small fish live here. */
  feed(x: number, y: number): void {
    const { life, world } = this;
    const place = life && world.dragPoint(x, y, world.middle, false);
    if (place) {
      place[2] = Math.max(place[2], world.room.low + 0.1 * world.size);
      life.feed(place);
    }
  }

  /** Show `count` more soft bodies of its kind around the body; 0 removes them. */
  async keepCrowd(count: number): Promise<void> {
    this.world.showCrowd(null);
    this.crowd = null;
    this.#wantedCrowd = count;
    if (count === 0 || !this.movers) {
      return;
    }
    // A separate module: its memory is freed with the crowd.
    const emulator = await Emulator.start(this.emulatorModule, this.emulator.sizes);
    // Another one may have been requested since.
    if (count === this.#wantedCrowd) {
      this.crowd = new Crowd(emulator, this.facts, this.movers.path, count);
      const state = this.player.state();
      this.facts.parameters?.forEach(({ entry }) => this.crowd!.keep(entry, state[entry]!));
      this.world.showCrowd(this.crowd);
    }
  }

  /** Let `count` others walk around the body, each going its own way; 0 removes them. */
  async keepWalkers(count: number): Promise<void> {
    this.world.showWalkers(null);
    this.walkers = null;
    this.#wantedWalkers = count;
    const { facts, policy } = this;
    if (count === 0 || !(policy instanceof CommandedPolicy)) {
      return;
    }
    const emulator = await Emulator.start(this.emulatorModule, this.emulator.sizes);
    // They may have been removed since.
    if (count === this.#wantedWalkers) {
      this.walkers = new Walkers(emulator, policy, facts, count, () => rootPose(facts.root!, this.player.state()).position);
      this.world.showWalkers(this.walkers);
    }
  }

  dispose(): void {
    this.world.dispose();
  }
}

async function startPolicy(module: WebAssembly.Module, facts: Bundle): Promise<Policy | CommandedPolicy> {
  const state = sizeOf(facts.state);
  const control = sizeOf(facts.control);
  const { command } = facts.policy!;
  return isWalking(facts)
    ? CommandedPolicy.start(module, state, control, command.length)
    : Policy.start(module, state, control);
}

function timeSteps(emulator: Emulator, facts: Bundle): number {
  const control = facts.default_motion.controls[0] ?? facts.control_low;
  const controls = new Float32Array(TIMED_STEPS * control.length);
  for (let step = 0; step < TIMED_STEPS; step++) {
    controls.set(control, step * control.length);
  }
  emulator.rollout(facts.rest, controls);
  const before = performance.now();
  emulator.rollout(facts.rest, controls);
  return (performance.now() - before) / 1000 / TIMED_STEPS;
}
