// The panel "Reach a goal", where descent through the emulator finds controls. Its context is the part of the page it may use.

import type { Bundle, LoadedBundle } from "../bundle/bundle";
import { rootPose } from "../body/root";
import type { Emulator } from "../emulator/emulator";
import { fetchModule } from "../emulator/instance";
import type { Player } from "../motion/player";
import { button, element, shortNumber } from "../page/dom";
import { lineOf, type Notices } from "../page/banner";
import { Curve } from "../panels/curve";
import { makePathLine, TARGET_COLOUR, type PathLine } from "../scene/handle";
import type { World } from "../scene/world";
import type { Physics } from "../physics/physics";
import type { Live } from "../server/live";
import { Aim } from "./aim";
import type { Iteration } from "./descend";
import type { DescentFacts, Values } from "./facts";
import { canJudge, type Court, type Proof } from "./proof";
import { motionOf, pathOf, physicsMotion, type Result } from "./result";
import { MAX_CORRECTIONS, search, type Progress } from "./search";
import { Siblings } from "./siblings";
import { Synthesiser } from "./synthesiser";

/**
 * Time for which an iteration is shown [ms]: the descent itself is faster than the eye, and twenty take less than a second.
 * If an image takes longer, it shows the latest one; the curve has all of them.
 */
const PACE = 40;

/** Maximum number of results kept side by side. */
const MAX_RESULTS = 6;

/** Opacity of the paths of other results. */
const OTHER_OPACITY = 0.25;

const FIND = "Find controls";

/** The wanted result. */
interface Sought {
  readonly start: readonly number[];
  readonly values: Values;
}

/** The result of a descent, with or without its proof. */
interface Found {
  readonly iteration: Iteration;
  readonly proof: Proof | null;
}

type Proved = Found & { readonly proof: Proof };

export interface SynthesisContext {
  readonly bundle: LoadedBundle;
  readonly emulator: Emulator;
  readonly player: Player;
  readonly world: World;
  /** Physics that replays controls, or null. */
  readonly physics: Physics | null;
  /** Connection to the server, which judges motions, or null. */
  readonly live: Live | null;
  readonly notices: Notices;
  /** Why there is no physics, if there is none. */
  readonly noPhysics: string;
  /** The empty body of the panel, to be filled. */
  readonly body: HTMLElement;
}

export interface Synthesis {
  /** Called once per image. */
  update(seconds: number): void;
  /** A pointer went down at x, y (-1 to 1 across the picture, and up); return true to take its drag. */
  grab(x: number, y: number): boolean;
  /** The grabbed pointer moved, or went up. */
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

/** Wait until a time [ms], if it is in the future. */
async function until(time: number): Promise<void> {
  const wait = time - performance.now();
  if (wait > 0) {
    await new Promise((resume) => setTimeout(resume, wait));
  }
}

class GoalPanel implements Synthesis {
  readonly #aim: Aim;
  readonly #curve = new Curve("cost, lower is better (logarithmic)");
  readonly #said = element("p", "said", ["Drag the target, then press the button."]);
  readonly #verdict = element("p", "verdict");
  readonly #list = element("div", "results");
  readonly #find: HTMLButtonElement;
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
  #isGone = false;

  constructor(
    private readonly context: SynthesisContext,
    private readonly facts: DescentFacts,
  ) {
    const { world, bundle } = context;
    this.#aim = new Aim(facts, bundle, world);
    this.#aim.onChange = () => this.#again();
    this.#siblings = new Siblings(bundle.facts, world);
    this.#beside.type = "checkbox";
    this.#beside.addEventListener("change", () => this.#showOthers());
    this.#besideRow.hidden = true;
    this.#line = this.#addLine(0.9);
    const proving = this.#court ? ", and verify them on the true physics" : "";
    this.#find = button({ label: FIND, className: "primary", title: `Find controls by descent through the emulator${proving}`, onClick: () => this.#toggle() });
    this.#verdict.setAttribute("role", "status");
    this.#fromHere.type = "checkbox";
    this.#fromHere.addEventListener("change", () => this.#moveStart());
    const from = element("label", "row", [this.#fromHere, "from where it is now"]);
    if (!facts.movable.some((movable) => movable.kind === "place")) {
      this.#said.textContent = "Press the button: descent through the emulator finds the controls.";
    }
    // A pointer near the button is likely to press it: the module is loaded by then.
    context.body.addEventListener("pointerenter", () => void this.#opened().catch(() => undefined), { once: true });
    context.body.append(
      element("p", "", [facts.about]),
      this.#aim.element,
      from,
      element("div", "row", [this.#find]),
      this.#said,
      this.#verdict,
      this.#curve.element,
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
    this.#siblings.update(this.context.player.time);
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
    this.context.notices.clear("synthesis");
    if (this.#running) {
      this.#running.abort();
    } else {
      void this.#search({ start: this.#start(), values: this.#aim.values });
    }
  }

  /** Search again after something was moved, if there was a search before. */
  #again(): void {
    if (this.#made > 0) {
      this.#running?.abort();
      void this.#search({ start: this.#start(), values: this.#aim.values });
    }
  }

  #start(): number[] {
    return this.#fromHere.checked ? Array.from(this.context.player.state()) : [...this.facts.start];
  }

  // A swimmer's target moves with its start; bays and pads stay.
  #moveStart(): void {
    const { root, scene } = this.context.bundle.facts;
    if (root && scene.kind === "water") {
      const from = rootPose(root, this.facts.start).position;
      const to = rootPose(root, this.#start()).position;
      this.#aim.shift(to.map((number, axis) => number - from[axis]!));
    }
  }

  /** Find controls and prove them, and show every iteration; the best on the physics is kept. */
  async #search(wanted: Sought): Promise<void> {
    const court = this.#court;
    const running = new AbortController();
    this.#running = running;
    this.#find.textContent = "Stop";
    this.#showVerdict(null);
    this.#costs = [];
    let iterations = 0;
    let latest: Progress | null = null;
    let best: Proved | null = null;
    let unproved = this.context.noPhysics;
    try {
      const synthesiser = await this.#opened();
      let due = performance.now();
      for await (const progress of search(synthesiser, court, wanted, running.signal)) {
        const { iteration, proof } = progress;
        if (proof) {
          best = nearer({ iteration, proof }, best);
          due = performance.now();
          continue;
        }
        this.#showIteration(iteration, latest === null);
        latest = progress;
        iterations += Math.min(iteration.iteration, 1);
        const isReplayed = court !== null && iteration.isDone;
        this.#said.textContent = isReplayed ? "Replaying on the true physics …" : sayProgress(progress, iterations);
        due += PACE;
        await until(due);
      }
    } catch (error) {
      unproved = lineOf(error);
      if (!latest?.iteration.isDone) {
        this.#synthesiser = null;
        this.context.notices.say("synthesis", `No controls were found: ${unproved}`, "error");
      }
    }
    if (this.#running !== running || this.#isGone) {
      return;
    }
    this.#running = null;
    this.#find.textContent = FIND;
    if (running.signal.aborted) {
      this.#said.textContent = "Stopped; the latest is shown.";
    } else if (latest?.iteration.isDone) {
      this.#said.textContent = sayProgress(latest, iterations);
      this.#keep(wanted, best ?? { iteration: latest.iteration, proof: null }, unproved);
    }
  }

  #showIteration(iteration: Iteration, isFirst: boolean): void {
    const { player, bundle, emulator } = this.context;
    this.#costs.push(iteration.cost);
    this.#curve.note = shortNumber(iteration.cost);
    this.#isDrawn = false;
    this.#line.show(pathOf(bundle.facts, iteration.states));
    const motion = motionOf(bundle.facts, emulator, iteration);
    if (isFirst) {
      // One undo brings the earlier motion back, not one for each iteration.
      player.show(motion);
    } else {
      player.motion = motion;
    }
    player.isPlaying = true;
  }

  #opened(): Promise<Synthesiser> {
    this.#synthesiser ??= this.#open();
    return this.#synthesiser;
  }

  async #open(): Promise<Synthesiser> {
    const module = await fetchModule(new URL(this.facts.wasm, this.context.bundle.folder));
    return new Synthesiser(this.facts, module);
  }

  /** Keep the result and show it from its start: the motion by physics, if it is proved. */
  #keep(wanted: Sought, { iteration, proof }: Found, unproved: string): void {
    const { player, bundle, emulator } = this.context;
    const states = proof?.states ?? iteration.states;
    const motion = proof ? physicsMotion(bundle.facts, states, iteration.controls) : motionOf(bundle.facts, emulator, iteration);
    const result: Result = {
      number: ++this.#made,
      start: wanted.start,
      values: wanted.values,
      cost: iteration.cost,
      motion,
      path: pathOf(bundle.facts, states),
      isSuccess: proof?.isSuccess ?? null,
      verdict: proof ? sayVerdict(proof) : `Found on the emulator, not verified: ${withinSentence(unproved)}.`,
    };
    this.#results = [...this.#results, result].slice(-MAX_RESULTS);
    player.motion = motion;
    player.seek(0);
    player.isPlaying = true;
    this.#select(result);
  }

  /** Show a result: its motion, its path among the others', and its verdict. */
  #select(result: Result): void {
    const { player } = this.context;
    this.#shown = result;
    this.#aim.restore(result.values);
    if (player.motion !== result.motion) {
      player.show(result.motion);
      player.isPlaying = true;
    }
    this.#showVerdict(result);
    this.#showOthers();
    this.#list.replaceChildren(...this.#results.map((one) => this.#chip(one)));
  }

  #showVerdict(result: Result | null): void {
    const isSuccess = result?.isSuccess ?? null;
    this.#verdict.className = isSuccess === null ? "verdict" : `verdict ${isSuccess ? "success" : "failure"}`;
    this.#verdict.textContent = result?.verdict ?? "";
    this.#verdict.scrollIntoView({ block: "nearest" });
  }

  #chip(result: Result): HTMLElement {
    const mark = result.isSuccess === null ? "" : result.isSuccess ? " ✓" : " ✗";
    const label = `${result.number}: cost ${shortNumber(result.cost)}${mark}`;
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

  /** The parts needed for a proof; null without physics. */
  get #court(): Court | null {
    const { bundle, physics, live } = this.context;
    const court = { bundle: bundle.facts, descent: this.facts, live };
    return physics !== null && canJudge(court) ? { ...court, physics } : null;
  }
}

/** Return the one closer to the goal on the physics. */
function nearer(one: Proved, other: Proved | null): Proved {
  const isNearer = other === null || one.proof.isSuccess || one.proof.gap < other.proof.gap;
  return isNearer ? one : other;
}

function sayProgress({ corrections }: Progress, iterations: number): string {
  const corrected = corrections === 0 ? "" : `, ${counted(corrections, "correction")}`;
  return `${counted(iterations, "iteration")}${corrected}`;
}

/** Return a sentence as a part of another one. */
function withinSentence(line: string): string {
  return line.charAt(0).toLowerCase() + line.slice(1).replace(/\.$/, "");
}

function counted(count: number, noun: string): string {
  return `${count} ${noun}${count === 1 ? "" : "s"}`;
}

function sayVerdict({ isSuccess, words }: Proof): string {
  return isSuccess ? `Success: the physics ${words}.` : `Not reached in ${MAX_CORRECTIONS} corrections: the physics ${words}.`;
}
