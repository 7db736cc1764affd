// A system on show: its session, physics beside it, its panels, and the parts that can be grabbed.

import { isPhysics, nameOf } from "../bundle/bundle";
import { EDGE } from "../motion/motion";
import { controlPanel, steerPanel, walkPanel, type Panel } from "../panels/controls";
import { moverPanel } from "../panels/movers";
import { parameterPanel } from "../panels/parameters";
import { MeasurePanel } from "../panels/measure";
import { takePanel } from "../panels/take";
import type { CameraMode } from "../scene/cameras";
import { HandOver } from "../physics/hand_over";
import { physicsOf, type Physics } from "../physics/physics";
import { Twin } from "../physics/twin";
import { sayNoPhysics } from "../server/advice";
import type { Live } from "../server/live";
import type { KeySteering } from "../steering/keys";
import { MoverDrag } from "../steering/drag";
import { BodyPull } from "../steering/pull";
import { SwimTarget } from "../steering/target";
import { makeSynthesis, type Synthesis } from "../synthesis/synthesis";
import { PassingNotices, type Action, type Banners } from "./banner";
import { element, panel } from "./dom";
import { FILM_RATE, FILM_SIZE, makeFilm, type Film } from "./film";
import type { Hud } from "./hud";
import type { Grabbable } from "./pointer";
import type { Session } from "./session";
import { isMotionReduced } from "./theme";

/** Mean score above which a banner says that the emulator is lost. */
const LOST = 3;
const FOUND = 1.5;

/** Share of a film's picture by which a motion may be too short for its last one, for rounding. */
const ROUNDING = 1e-6;

/** Speed of the scenery while the motion is paused. */
const IDLE_SPEED = 0.4;

export class Showing {
  /** Elements beside the stage. */
  readonly side: HTMLElement[];
  /** Things that can be grabbed, the foremost first. */
  readonly grabbables: readonly Grabbable[];
  readonly #physics: Physics | null;
  readonly #twin: Twin | null;
  readonly #measure: MeasurePanel;
  readonly #panels: Panel[];
  readonly #synthesis: Synthesis;
  readonly #target: SwimTarget;
  /** The hand on the body: it pulls at it, or drags its movers. */
  readonly #hand: BodyPull | MoverDrag;
  readonly #ghostState: Float32Array;
  #handOver: HandOver | null = null;
  #sceneTime = 0;
  #isFilming = false;
  readonly #end = new AbortController();
  readonly #notices: PassingNotices;
  /** Why there is no physics, if there is none. */
  readonly #noPhysics: string;

  /** `live` is the connection to the server, or null without one. */
  constructor(
    readonly session: Session,
    live: Live | null,
    banners: Banners,
    private readonly hud: Hud,
  ) {
    const { facts, player } = session;
    this.#notices = new PassingNotices(banners);
    this.#noPhysics = sayNoPhysics(live);
    this.#ghostState = new Float32Array(facts.rest.length);
    // The true physics has nothing beside it.
    this.#physics = isPhysics(facts) ? null : physicsOf(session.bundle, live);
    this.#twin = this.#physics && new Twin(this.#physics, facts);
    if (this.#twin) {
      this.#twin.onError = (line) => this.#notices.say("physics", `No physics ghost: ${this.#adviceOn(line)}`, "warning");
    }
    player.onEvent = (event) => this.#happened(event);
    player.isPlaying = !isMotionReduced();
    this.#target = new SwimTarget(session);
    const goLive = (): void => this.goLive();
    this.#hand = session.movers ? new MoverDrag(session, session.movers.pilot, goLive) : new BodyPull(session, goLive);
    this.#measure = new MeasurePanel(session, this.#twin, this.#noPhysics, () => this.toggleGhost());
    const steer = moverPanel(session, goLive) ?? walkPanel(session, goLive) ?? steerPanel(session, goLive, () => this.toggleTarget());
    const parameters = parameterPanel(session, goLive);
    const goal = panel("Reach a goal", steer === null && parameters === null);
    const controls = controlPanel(session, () => this.goLive());
    const take = takePanel(session, live, banners, (onProgress, signal) => this.#film(onProgress, signal));
    this.#panels = [steer, parameters, controls, this.#measure, take].filter((one) => one !== null);
    this.#synthesis = makeSynthesis({
      bundle: session.bundle,
      emulator: session.emulator,
      player,
      world: session.world,
      physics: this.#physics,
      live,
      notices: this.#notices,
      noPhysics: this.#noPhysics,
      body: goal.body,
    });
    this.grabbables = [this.#synthesis, this.#target, this.#hand];
    const about = element("div", "about", [element("h1", "", [nameOf(facts)]), element("p", "", [facts.about])]);
    const elements = [about, steer?.element, parameters?.element, goal.details, controls.element, this.#measure.element, take.element];
    this.side = elements.filter((one) => one !== undefined);
  }

  /** Remove its messages from the page, and stop its physics. */
  dispose(): void {
    this.#end.abort(new Error("another system is shown now."));
    this.#notices.clear("load");
    this.#notices.end();
    this.#handOver?.stop();
    this.#synthesis.dispose();
    this.#target.hide();
    this.#hand.dispose();
    this.session.dispose();
  }

  /** Advance by `seconds` and draw an image. */
  update(seconds: number, keys: KeySteering): void {
    if (this.#isFilming) {
      return;
    }
    if (keys.steer(this.session, seconds)) {
      this.#target.hide();
      this.goLive();
    }
    if (keys.isSteering) {
      this.session.life?.hold();
    }
    this.session.player.advance(seconds);
    this.#draw(seconds);
  }

  // Draw the state at the playhead, `seconds` after the image before.
  #draw(seconds: number): void {
    const { session } = this;
    const { player, world } = session;
    if (session.school && player.isPlaying) {
      session.school.target = session.swimmer?.target ?? null;
      session.school.advance(seconds * player.speed);
    }
    if (session.life && player.isPlaying) {
      session.life.advance(seconds * player.speed);
      if (player.isLive && !this.#target.isShown) {
        session.swimmer!.target = session.life.prey;
      }
    }
    if (session.crowd && player.isPlaying) {
      session.crowd.advance(seconds * player.speed, (number, state) => world.showInCrowd(number, state));
    }
    if (session.walkers && player.isPlaying) {
      session.walkers.advance(seconds * player.speed, (number, state) => world.showWalker(number, state));
    }
    if (!isMotionReduced()) {
      this.#sceneTime += seconds * (player.isPlaying ? player.speed : IDLE_SPEED);
    }
    if (!world.show(player.state())) {
      player.isPlaying = false;
      this.#happened("lost");
    }
    this.#showPhysics();
    this.#showTrust();
    this.#synthesis.update(seconds);
    this.#hand.update();
    world.draw(seconds, this.#sceneTime, this.#controlShares());
    this.#panels.forEach((one) => one.update());
  }

  /** Restart the shown motion, live. */
  restart(): void {
    const { player } = this.session;
    player.restart(this.#handOver?.origin ?? player.motion.state(0));
    player.isPlaying = true;
  }

  goLive(): void {
    const { player } = this.session;
    player.goLive();
    player.isPlaying = true;
  }

  undo(): void {
    if (!this.session.player.undo()) {
      this.#notices.tell("Nothing to undo.");
    }
  }

  nextCamera(): CameraMode {
    return this.session.world.camera.nextMode();
  }

  toggleGhost(): void {
    if (this.#twin) {
      this.#twin.isOn = !this.#twin.isOn;
    } else if (isPhysics(this.session.facts)) {
      this.#notices.tell("What you see is the true physics itself: there is nothing to compare it with.");
    } else {
      this.#notices.tell(this.#noPhysics, "warning");
    }
  }

  /** Show or hide a target in front of the swimmer. */
  toggleTarget(): void {
    if (!this.session.swimmer) {
      this.#notices.tell("This system has no policy that swims to a target; use 'Reach a goal'.");
    } else if (this.#target.isShown) {
      this.#target.hide();
    } else {
      this.#target.show();
      this.goLive();
    }
  }

  // Film the whole motion as it is shown: with the current camera, at the current speed.
  async #film(onProgress: (share: number) => void, signal: AbortSignal): Promise<Film> {
    const { player, world } = this.session;
    const { time, isPlaying, motion } = player;
    const step = player.speed / FILM_RATE;
    this.#isFilming = true;
    this.#sceneTime = 0;
    player.seek(0);
    player.isPlaying = true;
    world.filmSize = FILM_SIZE;
    world.show(player.state());
    world.moveCamera(Infinity);
    try {
      return await makeFilm({
        canvas: world.canvas,
        pictures: Math.floor(motion.duration / step + ROUNDING) + 1,
        draw: (picture) => {
          if (player.motion !== motion) {
            throw new Error("another motion is shown now.");
          }
          player.seek(picture * step);
          this.#draw(1 / FILM_RATE);
        },
        onProgress,
        signal: AbortSignal.any([signal, this.#end.signal]),
      });
    } finally {
      world.filmSize = null;
      player.seek(time);
      player.isPlaying = isPlaying;
      this.#isFilming = false;
    }
  }

  #happened(event: string): void {
    if (event === "lost") {
      const line = "The emulator diverged: its state is no longer finite. The last good pose stays; press R to restart, or Ctrl+Z to go back.";
      this.#notices.say("lost", line, "error", this.#handOverAction());
    } else if (event === "motion") {
      // What was said of the motion before is not true of this one.
      for (const topic of ["lost", "trust", "physics"]) {
        this.#notices.clear(topic);
      }
    }
  }

  #showPhysics(): void {
    const { player, world } = this.session;
    const twin = this.#twin;
    twin?.follow(player.motion, player.isLive && player.isPlaying);
    const physics = twin?.isOn ? twin.motion : null;
    if (physics && physics.duration + physics.dt > player.time) {
      physics.sample(player.time, this.#ghostState);
      world.showGhost(this.#ghostState);
    } else {
      world.showGhost(null);
    }
    this.hud.showGap(this.#measure.gap);
  }

  // The controls are not to blame for what a hand did.
  #adviceOn(line: string): string {
    const isPushed = this.session.player.motion.pushes().length > 0;
    return isPushed && line.includes("diverged") ? "the physics diverged after a push. Press R to restart, and push more gently." : line;
  }

  #showTrust(): void {
    const { player, world, facts } = this.session;
    const { score } = this.#measure;
    world.doubt = Math.min(Math.max((score - EDGE) / (LOST - EDGE), 0), 1);
    this.hud.showMode(player);
    this.hud.showTrust(player.motion.source === "physics" || player.isRecorded || isPhysics(facts) ? null : score, facts.verdict);
    // A recorded motion is watched, not steered: the glow and the label are enough.
    if (score > LOST && player.isLive && !isPhysics(facts)) {
      const line = "Training has not covered this: do not trust the emulator here. Press R to restart, or Ctrl+Z to go back.";
      this.#notices.say("trust", line, "warning", this.#handOverAction());
    } else if (score < FOUND || !player.isLive) {
      this.#notices.clear("trust");
    }
  }

  // Physics, if there is any, can go on where the emulator is lost.
  #handOverAction(): Action | undefined {
    const physics = this.#physics;
    return physics ? { label: "Continue with physics", act: () => this.#letPhysicsGoOn(physics) } : undefined;
  }

  #letPhysicsGoOn(physics: Physics): void {
    const { player, facts } = this.session;
    this.#handOver?.stop();
    this.#notices.clear("trust");
    this.#notices.clear("lost");
    this.#handOver = HandOver.begin(physics, facts, player, (line) => {
      this.#notices.say("physics", `Physics cannot continue: ${line}`, "warning");
    });
    this.#notices.tell("Physics continues from here, steered as before; L returns to the emulator.");
  }

  #controlShares(): number[] {
    const { motion, step } = this.session.player;
    if (motion.steps === 0) {
      return [];
    }
    const { control_low: low, control_high: high } = this.session.facts;
    return Array.from(motion.control(step), (value, i) => (value - low[i]!) / (high[i]! - low[i]!));
  }
}
