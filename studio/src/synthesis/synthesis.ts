// "Reach a goal": where descent through the emulator finds controls. What it may use of the page is its context.

import type { Bundle, LoadedBundle } from "../bundle/bundle";
import { rootPose } from "../body/root";
import type { Emulator } from "../emulator/emulator";
import { fetchModule } from "../emulator/instance";
import { Motion } from "../motion/motion";
import type { Player } from "../motion/player";
import { button, element, shortNumber } from "../page/dom";
import { lineOf, type Banners } from "../page/banner";
import { Curve } from "../panels/curve";
import { makePathLine, TARGET_COLOUR, type PathLine } from "../scene/handle";
import type { World } from "../scene/world";
import type { Physics } from "../physics/physics";
import type { Live } from "../server/live";
import { Aim } from "./aim";
import type { Iteration } from "./descend";
import type { DescentFacts } from "./facts";
import { canJudge, prove } from "./proof";
import { motionOf, pathOf, type Result } from "./result";
import type { Wanted } from "./serve";
import { Siblings } from "./siblings";
import { Synthesiser } from "./synthesiser";

/**
 * An iteration is looked at for so long [ms]: the descent itself is quicker than the eye, and twenty take less than a second.
 * Where an image takes longer than that it shows the latest there is; the curve has all of them.
 */
const PACE = 40;

/** The gap to physics is closed within so many rounds, or it is not. */
const ROUNDS = 3;

/** So many results are kept side by side. */
const MAX_RESULTS = 6;

/** Colour of paths that are not shown at present. */
const OTHER_OPACITY = 0.25;

const PROVE = "Replay the controls on the true physics";

export interface SynthesisContext {
  readonly bundle: LoadedBundle;
  readonly emulator: Emulator;
  readonly player: Player;
  readonly world: World;
  /** What replays controls, or null where nothing does. */
  readonly physics: Physics | null;
  /** The line to the server, which judges what physics did; or null where there is none. */
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
  const facts = context.bundle.facts.descents[0] as DescentFacts | undefined;
  if (facts) {
    return new GoalPanel(context, facts);
  }
  context.body.append(element("p", "", [sayNoGoal(context.bundle.facts)]));
  return {
    update: () => undefined,
    grab: () => false,
    drag: () => undefined,
    release: () => undefined,
    dispose: () => undefined,
  };
}

function sayNoGoal({ system, ...facts }: Bundle): string {
  if (facts.model === "physics") {
    return `Goals are reached through an emulator, and none of the ${system} ships: 'neuroanimator train ${system}' makes one; drop its file here.`;
  }
  return "There is no goal for this system in the page; 'neuroanimator control' takes any.";
}

/** Wait until a time [ms], if it is still to come. */
async function until(time: number): Promise<void> {
  const wait = time - performance.now();
  if (wait > 0) {
    await new Promise((resume) => setTimeout(resume, wait));
  }
}

class GoalPanel implements Synthesis {
  readonly #aim: Aim;
  readonly #curve = new Curve("J over iterations (logarithmic)");
  readonly #said = element("p", "said", ["Drag the target, then press the button."]);
  readonly #verdict = element("p", "verdict");
  readonly #list = element("div", "results");
  readonly #find: HTMLButtonElement;
  readonly #prove: HTMLButtonElement;
  readonly #close: HTMLButtonElement;
  readonly #fromHere = element("input");
  readonly #beside = element("input");
  readonly #besideRow = element("label", "row", [this.#beside, "all side by side"]);
  readonly #siblings: Siblings;
  readonly #lines: PathLine[] = [];
  readonly #line: PathLine;
  #synthesiser: Promise<Synthesiser> | null = null;
  #running: AbortController | null = null;
  #results: Result[] = [];
  #shown: Result | null = null;
  #made = 0;
  #costs: number[] = [];
  #isDrawn = false;
  #ghost: Motion | null = null;
  #ghostState: Float32Array;
  #isGone = false;

  constructor(
    private readonly context: SynthesisContext,
    private readonly facts: DescentFacts,
  ) {
    const { world, bundle } = context;
    this.#aim = new Aim(facts, bundle, world);
    this.#aim.onChange = () => this.#again();
    this.#ghostState = new Float32Array(facts.state);
    this.#siblings = new Siblings(bundle.facts, world);
    this.#beside.type = "checkbox";
    this.#beside.addEventListener("change", () => this.#showOthers());
    this.#besideRow.hidden = true;
    this.#line = this.#addLine(0.9);
    this.#find = button({ label: "Find controls", className: "primary", title: "Find controls by descent through the emulator", onClick: () => this.#toggle() });
    const proof = this.#canProve ? PROVE : "The proof of this system needs the server: run 'neuroanimator studio'";
    this.#prove = button({ label: "Prove it", title: proof, onClick: () => void this.#proveShown() });
    this.#close = button({ label: "Close the gap", title: "Learn from the replay and descend again", onClick: () => void this.#closeGap() });
    this.#prove.disabled = true;
    this.#close.hidden = true;
    this.#verdict.setAttribute("role", "status");
    this.#fromHere.type = "checkbox";
    this.#fromHere.addEventListener("change", () => this.#moveStart());
    const from = element("label", "row", [this.#fromHere, "from where it is now"]);
    if (!facts.movable.some((movable) => movable.kind === "place")) {
      this.#said.textContent = "Press the button: descent through the emulator finds the controls.";
    }
    // Whoever comes near is likely to press the button: the module is there by then.
    context.body.addEventListener("pointerenter", () => void this.#opened().catch(() => undefined), { once: true });
    context.body.append(
      element("p", "", [facts.about]),
      this.#aim.element,
      from,
      element("div", "row", [this.#find, this.#prove, this.#close]),
      this.#curve.element,
      this.#said,
      this.#verdict,
      this.#list,
      this.#besideRow,
    );
  }

  update(): void {
    if (!this.#isDrawn) {
      this.#isDrawn = true;
      const logs = this.#costs.map((cost) => Math.log10(Math.max(cost, 1e-12)));
      const length = Math.max(logs.length, this.facts.settings.iterations / 2);
      this.#curve.draw([{ values: logs, colour: "--accent" }], length, Math.min(...logs, 0), Math.max(...logs, 1));
    }
    const { player, world } = this.context;
    if (this.#ghost && this.#shown && player.motion === this.#shown.motion) {
      this.#ghost.sample(player.time, this.#ghostState);
      world.showGhost(this.#ghostState);
    }
    this.#siblings.update(player.time);
  }

  grab(x: number, y: number): boolean {
    return this.#aim.grab(x, y);
  }

  drag(x: number, y: number): void {
    this.#aim.drag(x, y);
  }

  release(): void {
    this.#aim.release();
  }

  dispose(): void {
    this.#isGone = true;
    this.#running?.abort();
    this.#aim.dispose();
    this.#siblings.dispose();
    for (const line of [this.#line, ...this.#lines]) {
      this.context.world.remove(line.object);
      line.dispose();
    }
    void this.#synthesiser?.then((synthesiser) => synthesiser.dispose()).catch(() => undefined);
  }

  #toggle(): void {
    if (this.#running) {
      this.#running.abort();
      return;
    }
    void this.#descend({ start: this.#start(), values: this.#aim.values });
  }

  /** Something was moved: whoever has looked for controls before wants others. */
  #again(): void {
    if (this.#made > 0) {
      this.#running?.abort();
      void this.#descend({ start: this.#start(), values: this.#aim.values });
    }
  }

  #start(): number[] {
    return this.#fromHere.checked ? Array.from(this.context.player.state()) : [...this.facts.start];
  }

  // A swimmer's target goes along with where it begins; bays and pads stay where they are.
  #moveStart(): void {
    const { root, scene } = this.context.bundle.facts;
    if (root && scene.kind === "water") {
      const from = rootPose(root, this.facts.start).position;
      const to = rootPose(root, this.#start()).position;
      this.#aim.shift(to.map((number, axis) => number - from[axis]!));
    }
  }

  /** Descend, and show every iteration; return the result, or null where it was stopped. */
  async #descend(wanted: Wanted & { readonly start: number[] }): Promise<Result | null> {
    const { player, bundle, emulator, banners } = this.context;
    const running = new AbortController();
    this.#running = running;
    this.#find.textContent = "Stop";
    this.#prove.disabled = true;
    this.#verdict.textContent = "";
    this.#close.hidden = true;
    this.#ghost = null;
    this.#costs = [];
    const before = player.motion;
    let began = 0;
    let last: Iteration | null = null;
    let isFirst = true;
    try {
      const synthesiser = await this.#opened();
      for await (const iteration of synthesiser.descend(wanted, running.signal)) {
        last = iteration;
        began ||= performance.now();
        this.#costs.push(iteration.cost);
        this.#isDrawn = false;
        this.#tell(iteration);
        this.#line.show(pathOf(bundle.facts, iteration.states));
        const motion = motionOf(bundle.facts, emulator, iteration);
        if (isFirst) {
          // What was there before comes back with one step of undo, not with one for each iteration.
          player.show(motion);
          isFirst = false;
        } else {
          player.motion = motion;
        }
        player.isPlaying = true;
        await until(began + PACE * (iteration.iteration + 1));
      }
    } catch (error) {
      this.#synthesiser = null;
      banners.say("synthesis", `No controls were found: ${lineOf(error)}`, "error");
    } finally {
      if (this.#running === running) {
        this.#running = null;
        this.#find.textContent = "Find controls";
      }
    }
    if (!last || running.signal.aborted || this.#isGone) {
      if (!isFirst && player.motion !== before) {
        this.#said.textContent = "Stopped; the best so far is shown.";
      }
      return null;
    }
    const result = this.#keep(wanted, last, player.motion);
    player.seek(0);
    this.#select(result, false);
    return result;
  }

  #opened(): Promise<Synthesiser> {
    this.#synthesiser ??= this.#open();
    return this.#synthesiser;
  }

  async #open(): Promise<Synthesiser> {
    const module = await fetchModule(new URL(this.facts.wasm, this.context.bundle.folder));
    return new Synthesiser(this.facts, module);
  }

  #tell(iteration: Iteration): void {
    const count = iteration.iteration === 1 ? "1 iteration" : `${iteration.iteration} iterations`;
    this.#curve.note = `J ${shortNumber(iteration.cost)}`;
    this.#said.textContent = `${count}, ${iteration.milliseconds.toFixed(0)} ms`;
  }

  #keep(wanted: Wanted & { readonly start: number[] }, last: Iteration, motion: Motion): Result {
    const result: Result = {
      number: ++this.#made,
      start: wanted.start,
      values: wanted.values ?? {},
      z: last.z,
      iterations: last.iteration,
      cost: last.cost,
      milliseconds: last.milliseconds,
      motion,
      path: pathOf(this.context.bundle.facts, last.states),
      proof: null,
    };
    this.#results = [...this.#results, result].slice(-MAX_RESULTS);
    return result;
  }

  /** Show a result: its motion, its path among the others', what is known of it. */
  #select(result: Result, isPlayed = true): void {
    const { player } = this.context;
    this.#shown = result;
    this.#aim.restore(result.values);
    if (isPlayed && player.motion !== result.motion) {
      player.show(result.motion);
      player.isPlaying = true;
    }
    this.#prove.disabled = !this.#canProve;
    this.#showProof();
    this.#showOthers();
    this.#list.replaceChildren(...this.#results.map((one) => this.#chip(one)));
  }

  #chip(result: Result): HTMLElement {
    const proof = result.proof;
    const mark = proof === null ? "" : proof.isSuccess ? " ✓" : " ✗";
    const label = `${result.number}: J ${shortNumber(result.cost)}${mark}`;
    const made = button({ label, title: `Show result ${result.number}`, onClick: () => this.#select(result) });
    made.setAttribute("aria-current", String(result === this.#shown));
    return made;
  }

  #showOthers(): void {
    const others = this.#results.filter((one) => one !== this.#shown);
    others.forEach((one, i) => (this.#lines[i] ??= this.#addLine(OTHER_OPACITY)).show(one.path));
    this.#lines.slice(others.length).forEach((line) => line.show([]));
    this.#line.show(this.#shown?.path ?? []);
    this.#besideRow.hidden = others.length === 0;
    this.#siblings.show(this.#beside.checked ? others : []);
  }

  #addLine(opacity: number): PathLine {
    const line = makePathLine(TARGET_COLOUR, opacity, this.facts.steps + 1);
    line.show([]);
    this.context.world.add(line.object);
    return line;
  }

  get #canProve(): boolean {
    const { bundle, physics, live } = this.context;
    return physics !== null && canJudge({ bundle: bundle.facts, descent: this.facts, live });
  }

  async #proveShown(): Promise<void> {
    const { bundle, physics, live, banners } = this.context;
    const result = this.#shown;
    if (!physics || !result) {
      return;
    }
    this.#prove.disabled = true;
    this.#verdict.textContent = "The physics runs …";
    try {
      result.proof = await prove({ bundle: bundle.facts, descent: this.facts, physics, live }, result);
    } catch (error) {
      this.#verdict.textContent = "";
      banners.say("synthesis", `No proof: ${lineOf(error)}`, "error");
    }
    if (result === this.#shown && !this.#isGone) {
      this.#select(result);
      this.context.player.seek(0);
    }
  }

  // What physics did goes along as the ghost.
  #showProof(): void {
    const proof = this.#shown?.proof ?? null;
    this.#ghost = null;
    this.#close.hidden = proof === null || proof.isSuccess;
    this.#verdict.textContent = "";
    this.#verdict.className = "verdict";
    if (!proof || !this.#shown) {
      return;
    }
    const { motion } = this.#shown;
    const structure = { rates: this.context.bundle.facts.rates, orientations: this.context.bundle.facts.orientations };
    const size = motion.stateSize;
    this.#ghost = new Motion(motion.dt, size, motion.controlSize, structure, proof.states.subarray(0, size));
    for (let step = 0; step < motion.steps; step++) {
      this.#ghost.append(motion.control(step), proof.states.subarray((step + 1) * size, (step + 2) * size), 0);
    }
    this.#verdict.classList.add(proof.isSuccess ? "success" : "failure");
    this.#verdict.textContent = `${proof.isSuccess ? "Success" : "Not yet"}: the physics ${proof.words}.`;
  }

  /** Descend again with what the emulator got wrong added to it, and prove that, a few times over. */
  async #closeGap(): Promise<void> {
    for (let round = 0; round < ROUNDS; round++) {
      const from = this.#shown;
      if (!from?.proof || from.proof.isSuccess || this.#running || this.#isGone) {
        return;
      }
      const synthesiser = await this.#opened();
      const defects = await synthesiser.correct(from.proof.states, from.motion.controls());
      const wanted = { start: [...from.start], values: from.values, guess: from.z, defects };
      if (!(await this.#descend(wanted))) {
        return;
      }
      await this.#proveShown();
    }
  }
}
