// The page: what is where, and who is told what.

import type { CatalogueEntry } from "../bundle/catalogue";
import { isPhysics } from "../bundle/bundle";
import { loadCatalogue, type Catalogue } from "../bundle/catalogue";
import { controlPanel, steerPanel, type Panel } from "../panels/controls";
import { makeHelp } from "../panels/help";
import { MeasurePanel, trustAt } from "../panels/measure";
import { Picker } from "../panels/picker";
import { takePanel } from "../panels/take";
import { Timeline } from "../panels/timeline";
import { isModelFile, TrainPanel } from "../panels/train";
import { Stage } from "../scene/stage";
import { Live, type Answer } from "../server/live";
import { HandOver } from "../server/hand_over";
import { Twin } from "../server/twin";
import { clamp } from "../steering/pilots";
import { KeySteering } from "../steering/keys";
import { BodyPull } from "../steering/pull";
import { SwimTarget } from "../steering/target";
import { makeSynthesis, type Synthesis } from "../synthesis/synthesis";
import { Banners, type Action } from "./banner";
import { button, element, panel, shortNumber } from "./dom";
import { Keyboard } from "./keyboard";
import { Pointer, type Grabbable } from "./pointer";
import { Session } from "./session";
import { followTheme, isDark, isMotionReduced, toggleTheme } from "./theme";

/** Trust below which a banner says that the emulator is lost. */
const LOST = 0.35;

export class App {
  readonly #page = new URL("./", document.baseURI);
  readonly #banners = new Banners();
  readonly #canvas = element("canvas");
  readonly #stageBox: HTMLElement;
  readonly #side = element("aside", "side");
  readonly #help = makeHelp();
  readonly #picker: Picker;
  readonly #keys: KeySteering;
  readonly #pointer: Pointer;
  readonly #trustChip = element("span", "chip trust", ["covered by training"]);
  readonly #gapChip = element("span", "chip ghost");
  readonly #modeChip = element("span", "chip");
  readonly #cameraButton: HTMLButtonElement;
  #stage: Stage | null = null;
  #live: Live | null = null;
  #train: TrainPanel | null = null;
  #session: Session | null = null;
  #timeline: Timeline | null = null;
  #twin: Twin | null = null;
  #measure: MeasurePanel | null = null;
  #handOver: HandOver | null = null;
  #panels: Panel[] = [];
  #synthesis: Synthesis | null = null;
  #target: SwimTarget | null = null;
  #pull: BodyPull | null = null;
  #entries: CatalogueEntry[] = [];
  #opening = 0;
  #last = performance.now();
  #sceneTime = 0;
  #images = 0;

  constructor() {
    this.#picker = new Picker((entry) => void this.open(entry));
    this.#cameraButton = button({ label: "Follow", title: "Camera: follow, chase, stay (C)", onClick: () => this.#nextCamera() });
    this.#keys = new KeySteering(new Keyboard(this.#actions()).held);
    this.#pointer = new Pointer(this.#canvas, () => this.#grabbables(), (isHeld) => this.#held(isHeld));
    this.#canvas.tabIndex = 0;
    this.#canvas.setAttribute("aria-label", "The stage");
    const hud = element("div", "hud", [this.#modeChip, this.#trustChip, this.#gapChip]);
    this.#stageBox = element("main", "stage", [this.#canvas, hud, this.#banners.element]);
    this.#gapChip.hidden = true;
    document.body.append(this.#bar(), this.#stageBox, this.#side, this.#help);
    followTheme(() => this.#redecorate());
  }

  /** Load the catalogue and show the first system. */
  async start(): Promise<void> {
    try {
      this.#stage = new Stage(this.#canvas, new URLSearchParams(location.search).has("fine"));
    } catch {
      this.#banners.say("webgl", "This browser shows no WebGL: switch on hardware acceleration, or open the page in another browser.", "error");
      return;
    }
    this.#listen(this.#stage);
    let catalogue: Catalogue;
    try {
      catalogue = await loadCatalogue(this.#page);
    } catch (error) {
      this.#banners.say("load", `The list of systems did not come: ${lineOf(error)}. Reload the page; is the server running?`, "error");
      return;
    }
    this.#entries = [...catalogue.entries];
    this.#entries.forEach((entry) => this.#picker.add(entry));
    if (catalogue.has_server) {
      this.#connect();
    }
    const wanted = new URLSearchParams(location.search).get("show");
    const first = this.#entries.find((entry) => entry.id === wanted) ?? this.#entries.find((entry) => entry.system === "fish") ?? this.#entries[0];
    if (first) {
      await this.open(first);
    }
    this.#stage.renderer.setAnimationLoop(() => this.#image());
  }

  /** Put a system on the stage; the one before stays until it is there. */
  async open(entry: CatalogueEntry): Promise<void> {
    const stage = this.#stage;
    if (!stage) {
      return;
    }
    const opening = ++this.#opening;
    this.#picker.select(entry.id);
    let session: Session | null;
    const previous = this.#session;
    try {
      session = await Session.open(entry, this.#page, stage, isDark(), () => opening === this.#opening);
    } catch (error) {
      this.#banners.say("load", `${entry.id} was not loaded: ${lineOf(error)}`, "error");
      if (previous) {
        this.#picker.select(previous.entry.id);
      }
      return;
    }
    if (!session) {
      return;
    }
    this.#pointer.release();
    this.#close(previous);
    this.#session = session;
    session.player.onEvent = (event) => this.#happened(event);
    session.player.isPlaying = !isMotionReduced();
    this.#twin = this.#live && session.facts.can_simulate !== false && !isPhysics(session.facts) ? new Twin(this.#live, session.facts) : null;
    if (this.#twin) {
      this.#twin.onError = (line) => this.#banners.say("physics", `No physics beside it: ${line}`, "warning");
    }
    this.#target = new SwimTarget(session);
    this.#pull = new BodyPull(session, () => this.#goLive());
    this.#furnish(session);
    this.#remember(entry);
  }

  #remember(entry: CatalogueEntry): void {
    const address = new URL(location.href);
    address.searchParams.set("show", entry.id);
    history.replaceState(null, "", address);
    document.title = `${entry.id} – NeuroAnimator Studio`;
  }

  #close(session: Session | null): void {
    this.#banners.clear("load");
    this.#banners.clear("lost");
    this.#banners.clear("physics");
    this.#handOver?.stop();
    this.#handOver = null;
    this.#synthesis?.dispose();
    this.#synthesis = null;
    this.#target?.hide();
    session?.dispose();
  }

  // The panels and the timeline of a system.
  #furnish(session: Session): void {
    const goLive = (): void => this.#goLive();
    const steer = steerPanel(session, goLive, () => this.#toggleTarget());
    this.#measure = new MeasurePanel(session, this.#twin, () => this.#toggleGhost());
    const goal = panel("Reach a goal", steer === null);
    this.#panels = [
      ...(steer ? [steer] : []),
      { element: goal.details, update: () => undefined },
      controlPanel(session, goLive),
      this.#measure,
      takePanel(session, this.#live, this.#banners),
    ];
    const about = element("div", "about", [
      element("h1", "", [session.facts.id]),
      element("p", "", [session.facts.about]),
    ]);
    this.#side.replaceChildren(about, ...this.#panels.map((one) => one.element));
    if (this.#train) {
      this.#side.append(this.#train.element);
    }
    this.#side.scrollTop = 0;
    this.#synthesis = makeSynthesis({
      bundle: session.bundle,
      emulator: session.emulator,
      player: session.player,
      world: session.world,
      live: this.#live,
      banners: this.#banners,
      body: goal.body,
    });
    if (this.#timeline) {
      this.#timeline.follow(session.player);
    } else {
      this.#timeline = new Timeline(session.player, goLive);
      document.body.append(this.#timeline.element);
    }
    this.#cameraButton.textContent = "Follow";
  }

  #bar(): HTMLElement {
    const brand = element("div", "brand", ["NeuroAnimator ", element("span", "", ["Studio"])]);
    const side = button({ label: "☰", title: "Panels", className: "side-toggle", onClick: () => document.body.classList.toggle("with-side") });
    const theme = button({ label: "◐", title: "Light or dark", onClick: () => this.#toggleTheme() });
    const help = button({ label: "?", title: "Help (?)", onClick: () => this.#help.showModal() });
    const tools = element("div", "tools", [this.#cameraButton, theme, help, side]);
    return element("header", "bar", [brand, this.#picker.element, tools]);
  }

  #actions(): Record<string, () => void> {
    const withPlayer = (act: (player: Session["player"]) => void) => () => {
      if (this.#session) {
        act(this.#session.player);
      }
    };
    const withCamera = (act: (camera: Session["world"]["camera"]) => void) => () => {
      if (this.#session) {
        act(this.#session.world.camera);
      }
    };
    const picks = Array.from({ length: 9 }, (_, i) => [String(i + 1), () => this.#pick(i)] as const);
    return {
      ...Object.fromEntries(picks),
      " ": () => this.#timeline?.toggle(),
      ",": withPlayer((player) => player.stepBy(-1)),
      ".": withPlayer((player) => player.stepBy(1)),
      Home: withPlayer((player) => player.seek(0)),
      End: withPlayer((player) => player.seek(player.motion.duration)),
      "[": () => this.#timeline?.changeSpeed(-1),
      "]": () => this.#timeline?.changeSpeed(1),
      l: () => this.#goLive(),
      r: withPlayer((player) => this.#restart(player)),
      g: () => this.#toggleGhost(),
      t: () => this.#toggleTarget(),
      c: () => this.#nextCamera(),
      h: () => this.#session?.world.home(),
      "Shift+ArrowLeft": withCamera((camera) => camera.keyTurn(1, 0)),
      "Shift+ArrowRight": withCamera((camera) => camera.keyTurn(-1, 0)),
      "Shift+ArrowUp": withCamera((camera) => camera.keyTurn(0, 1)),
      "Shift+ArrowDown": withCamera((camera) => camera.keyTurn(0, -1)),
      "+": withCamera((camera) => camera.keyZoom(true)),
      "=": withCamera((camera) => camera.keyZoom(true)),
      "-": withCamera((camera) => camera.keyZoom(false)),
      "Ctrl+z": withPlayer((player) => player.undo() || this.#banners.tell("Nothing to undo.")),
      "?": () => this.#help.showModal(),
    };
  }

  #pick(number: number): void {
    const entry = this.#entries[number];
    if (entry) {
      void this.open(entry);
    }
  }

  #restart(player: Session["player"]): void {
    player.restart(player.motion.state(0));
    player.isPlaying = true;
  }

  #goLive(): void {
    const player = this.#session?.player;
    if (player) {
      player.goLive();
      player.isPlaying = true;
    }
  }

  #nextCamera(): void {
    const mode = this.#session?.world.camera.nextMode();
    if (mode) {
      this.#cameraButton.textContent = { follow: "Follow", chase: "Chase", orbit: "Stay" }[mode];
    }
  }

  #toggleTheme(): void {
    toggleTheme();
    this.#redecorate();
  }

  // Only the studio floor has other colours in the dark; the sea is the same at all times.
  #redecorate(): void {
    if (this.#session?.facts.scene.kind === "plain") {
      void this.open(this.#session.entry);
    }
  }

  #toggleGhost(): void {
    if (this.#session && isPhysics(this.#session.facts)) {
      this.#banners.tell("What you see is the true physics itself: there is nothing to put beside it.");
      return;
    }
    if (!this.#twin) {
      this.#banners.tell("Physics beside the emulator needs the server: run 'neuroanimator studio'.", "warning");
      return;
    }
    this.#twin.isOn = !this.#twin.isOn;
  }

  // A target in front of the swimmer, and off again.
  #toggleTarget(): void {
    if (!this.#session?.swimmer || !this.#target) {
      this.#banners.tell("This system has no policy that swims to a target; use 'Reach a goal'.");
    } else if (this.#target.isShown) {
      this.#target.hide();
    } else {
      this.#target.show();
      this.#goLive();
    }
  }

  #connect(): void {
    this.#live = new Live(this.#page);
    this.#live.onState = (isOpen) => {
      if (isOpen) {
        this.#banners.clear("server");
      } else {
        this.#banners.say("server", "The server does not answer; the emulator goes on without it. Start it again with 'neuroanimator studio'.", "warning");
      }
    };
    this.#live.onEvent = (event) => this.#told(event);
    this.#train = new TrainPanel(this.#live, this.#banners, (id) => void this.#showById(id));
    this.#live.connect();
  }

  // What the server says unasked.
  #told(event: Answer): void {
    if (event["event"] === "job") {
      this.#train?.tell(event);
    } else if (event["event"] === "emulator") {
      this.#banners.say("upload", `The emulator: ${String(event["phase"])} …`);
    } else if (event["event"] === "export" && Number(event["done"]) < Number(event["of"])) {
      this.#banners.say("export", `Writing ${String(event["format"])}: image ${String(event["done"])} of ${String(event["of"])} …`);
    } else if (event["event"] === "catalogue") {
      void this.#reloadCatalogue();
    }
  }

  async #reloadCatalogue(): Promise<void> {
    const catalogue = await loadCatalogue(this.#page).catch(() => null);
    for (const entry of catalogue?.entries ?? []) {
      if (!this.#entries.some((one) => one.id === entry.id)) {
        this.#entries.push(entry);
        this.#picker.add(entry);
      }
    }
  }

  async #showById(id: string): Promise<void> {
    await this.#reloadCatalogue();
    const entry = this.#entries.find((one) => one.id === id);
    if (!entry) {
      throw new Error(`the server shows no emulator called ${id}`);
    }
    await this.open(entry);
  }

  #listen(stage: Stage): void {
    new ResizeObserver(() => stage.resize()).observe(this.#stageBox);
    this.#canvas.addEventListener("webglcontextlost", (event) => {
      event.preventDefault();
      this.#banners.say("webgl", "The graphics card was lost; the picture comes back by itself, or reload the page.", "warning");
    });
    this.#canvas.addEventListener("webglcontextrestored", () => this.#banners.clear("webgl"));
    document.addEventListener("dragover", (event) => {
      event.preventDefault();
      document.body.classList.add("dropping");
    });
    document.addEventListener("dragleave", (event) => {
      if (event.relatedTarget === null) {
        document.body.classList.remove("dropping");
      }
    });
    document.addEventListener("drop", (event) => {
      event.preventDefault();
      document.body.classList.remove("dropping");
      const file = event.dataTransfer?.files[0];
      if (file) {
        void this.#upload(file);
      }
    });
    document.addEventListener("visibilitychange", () => (this.#last = performance.now()));
  }

  async #upload(file: File): Promise<void> {
    if (!this.#live) {
      this.#banners.say("upload", "A file of your own needs the server, which checks it and makes it run here: run 'neuroanimator studio'.", "warning");
      return;
    }
    if (isModelFile(file.name)) {
      await this.#train?.addModel(file);
      return;
    }
    this.#banners.say("upload", `Reading ${file.name} …`);
    try {
      const answer = await this.#live.post("api/emulators", file, "application/octet-stream");
      await this.#showById(String(answer["id"]));
      this.#banners.clear("upload");
    } catch (error) {
      this.#banners.say("upload", `${file.name}: ${lineOf(error)}`, "error");
    }
  }

  // What may be taken hold of, the foremost first.
  #grabbables(): Grabbable[] {
    return [this.#synthesis, this.#target, this.#pull].filter((one) => one !== null);
  }

  #held(isHeld: boolean): void {
    if (this.#session) {
      this.#session.world.camera.controls.enabled = !isHeld;
    }
  }

  #happened(event: string): void {
    if (event === "lost") {
      const line = "The emulator is lost: its state is no number any more. The last good pose stays; press R to begin again, or Ctrl+Z to go back.";
      this.#banners.say("lost", line, "error", this.#session ? this.#handOverAction(this.#session) : undefined);
    } else if (event === "motion") {
      this.#banners.clear("lost");
    }
  }

  #image(): void {
    const now = performance.now();
    const seconds = Math.min((now - this.#last) / 1000, 1);
    this.#last = now;
    const session = this.#session;
    if (!session) {
      return;
    }
    if (this.#keys.steer(session, seconds)) {
      this.#target?.hide();
      this.#goLive();
    }
    const { player, world } = session;
    player.advance(seconds);
    if (session.school && player.isPlaying) {
      session.school.target = session.swimmer?.target ?? null;
      session.school.advance(seconds * player.speed);
    }
    if (!isMotionReduced()) {
      this.#sceneTime += seconds * (player.isPlaying ? player.speed : 0.4);
    }
    if (!world.show(player.state())) {
      player.isPlaying = false;
      this.#happened("lost");
    }
    this.#showPhysics(session);
    this.#showTrust(session);
    this.#synthesis?.update(seconds);
    this.#pull?.update();
    document.documentElement.dataset["frames"] = String(++this.#images);
    world.draw(seconds, this.#sceneTime, this.#controlShares(session));
    this.#timeline?.update(seconds);
    this.#panels.forEach((one) => one.update());
  }

  #showPhysics(session: Session): void {
    const twin = this.#twin;
    const { player, world } = session;
    twin?.follow(player.motion, player.isLive && player.isPlaying);
    const physics = twin?.isOn ? twin.motion : null;
    if (physics) {
      physics.sample(player.time, this.#ghostState(session));
      world.showGhost(physics.duration + physics.dt > player.time ? this.#ghostState(session) : null);
    } else {
      world.showGhost(null);
    }
    const gap = this.#measure?.gap ?? null;
    this.#gapChip.hidden = gap === null;
    if (gap !== null) {
      setText(this.#gapChip, `physics: gap ${shortNumber(100 * gap)} cm`);
    }
  }

  #ghostBuffer = new Float32Array();

  #ghostState(session: Session): Float32Array {
    if (this.#ghostBuffer.length !== session.facts.rest.length) {
      this.#ghostBuffer = new Float32Array(session.facts.rest.length);
    }
    return this.#ghostBuffer;
  }

  #showTrust(session: Session): void {
    const { player, world } = session;
    const trust = trustAt(player.motion, player.step);
    world.doubt = clamp(1.4 * (1 - trust), 0, 1);
    const percent = Math.round(100 * trust);
    const said = trust === 1 ? "covered by training" : `${percent} % covered by training`;
    setText(this.#trustChip, player.isHeld || isPhysics(session.facts) ? "the true physics" : said);
    this.#trustChip.classList.toggle("doubt", trust < 1);
    setText(this.#modeChip, player.isHeld ? "physics" : player.isLive ? "live" : "recorded");
    if (trust < LOST && !isPhysics(session.facts)) {
      const line = "Training has not covered this: do not believe the emulator here. Press R to begin again, or Ctrl+Z to go back.";
      this.#banners.say("trust", line, "warning", this.#handOverAction(session));
    } else if (trust > 0.8) {
      this.#banners.clear("trust");
    }
  }

  // With a server there, physics can go on where the emulator is lost.
  #handOverAction(session: Session): Action | undefined {
    const live = this.#live;
    if (!live || session.facts.can_simulate === false) {
      return undefined;
    }
    const { player } = session;
    const act = (): void => {
      this.#handOver?.stop();
      this.#banners.clear("trust");
      this.#banners.clear("lost");
      const state = player.motion.state(player.step).slice();
      this.#handOver = HandOver.begin(live, session.facts, player, state, (line) => {
        this.#banners.say("physics", `Physics does not go on: ${line}`, "warning");
      });
      this.#banners.tell("Physics goes on from here, steered as before.");
    };
    return { label: "Let physics go on", act };
  }

  #controlShares(session: Session): number[] {
    const { motion, step } = session.player;
    if (motion.steps === 0) {
      return [];
    }
    const { control_low: low, control_high: high } = session.facts;
    return Array.from(motion.control(step), (value, i) => (value - low[i]!) / (high[i]! - low[i]!));
  }
}

function setText(node: HTMLElement, text: string): void {
  if (node.textContent !== text) {
    node.textContent = text;
  }
}

function lineOf(error: unknown): string {
  return error instanceof Error ? error.message : String(error);
}
