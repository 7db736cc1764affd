// The page: its layout, the system on show, and the clock of the images.

import { loadCatalogue, type Catalogue, type CatalogueEntry } from "../bundle/catalogue";
import { nameOf } from "../bundle/bundle";
import { makeHelp } from "../panels/help";
import { Picker } from "../panels/picker";
import { Timeline } from "../panels/timeline";
import { Stage } from "../scene/stage";
import { sayNoServer } from "../server/advice";
import { Server } from "../server/server";
import { KeySteering, steeredBy } from "../steering/keys";
import { Banners, lineOf } from "./banner";
import { makeBar } from "./bar";
import { element } from "./dom";
import { listenForFiles } from "./drop";
import { Hud } from "./hud";
import { Keyboard } from "./keyboard";
import { Pointer } from "./pointer";
import { Session } from "./session";
import { makeSticks } from "./sticks";
import { shortcuts, type Workplace } from "./shortcuts";
import { Showing } from "./showing";
import { followTheme, isDark, toggleTheme } from "./theme";

/** System shown first if the address names none. */
const FIRST_SYSTEM = "fish";

/** Maximum time between two images [s]. */
const MAX_IMAGE = 1;

export class App implements Workplace {
  showing: Showing | null = null;
  timeline: Timeline | null = null;
  readonly #page = new URL("./", document.baseURI);
  readonly #banners = new Banners();
  readonly #hud = new Hud();
  readonly #canvas = element("canvas");
  /** Covers the stage until it shows something. */
  readonly #loading = document.querySelector<HTMLElement>(".loading")!;
  readonly #stageBox: HTMLElement;
  readonly #side = element("aside", "side");
  readonly #help = makeHelp();
  readonly #picker = new Picker((entry) => void this.open(entry));
  readonly #bar = makeBar(this.#picker.element, {
    nextCamera: () => this.nextCamera(),
    toggleTheme: () => this.#toggleTheme(),
    help: () => this.help(),
  });
  readonly #held = new Keyboard(shortcuts(this)).held;
  readonly #keys = new KeySteering(this.#held);
  readonly #sticks = makeSticks(this.#held);
  readonly #pointer: Pointer;
  #stage: Stage | null = null;
  #server: Server | null = null;
  #entries: CatalogueEntry[] = [];
  #opening = 0;
  #last = performance.now();
  #images = 0;

  constructor() {
    this.#canvas.tabIndex = 0;
    this.#canvas.setAttribute("aria-label", "The stage");
    this.#pointer = new Pointer(
      this.#canvas,
      () => this.showing?.grabbables ?? [],
      (isHeld) => this.#hold(isHeld),
      (x, y) => this.showing?.session.feed(x, y),
    );
    this.#stageBox = element("main", "stage", [this.#canvas, this.#hud.element, this.#sticks.element, this.#loading, this.#banners.element]);
    document.body.append(this.#bar.element, this.#stageBox, this.#side, this.#help);
    followTheme(() => this.#redecorate());
    listenForFiles((file) => this.#take(file));
  }

  /** Load the catalogue and show the first system. */
  async start(): Promise<void> {
    const asked = new URLSearchParams(location.search);
    try {
      this.#stage = new Stage(this.#canvas, asked.has("fine"));
    } catch {
      this.#fail("webgl", "This browser has no WebGL: turn on hardware acceleration, or open the page in another browser.");
      return;
    }
    this.#listen(this.#stage);
    let catalogue: Catalogue;
    try {
      catalogue = await loadCatalogue(this.#page);
    } catch (error) {
      this.#fail("load", `The list of systems could not be loaded: ${lineOf(error)}. Reload the page; is the server running?`);
      return;
    }
    this.#add(catalogue);
    if (catalogue.has_server) {
      this.#server = new Server(this.#page, this.#banners, {
        systems: catalogue.systems,
        reloadCatalogue: () => this.#reloadCatalogue(),
        show: (id) => this.#showById(id),
      });
    }
    const wanted = this.#entries.find((entry) => entry.id === asked.get("show"));
    const first = wanted ?? this.#entries.find((entry) => entry.system === FIRST_SYSTEM) ?? this.#entries[0];
    if (first) {
      await this.open(first);
    }
    this.#stage.renderer.setAnimationLoop(() => this.#image());
  }

  /** Put a system on the stage; the previous one stays until it is ready. */
  async open(entry: CatalogueEntry): Promise<void> {
    const stage = this.#stage;
    if (!stage) {
      return;
    }
    const opening = ++this.#opening;
    this.#picker.select(entry.id);
    this.#loading.hidden = false;
    let session: Session | null;
    try {
      session = await Session.open(entry, this.#page, stage, isDark(), () => opening === this.#opening);
    } catch (error) {
      this.#fail("load", `${nameOf(entry)} could not be loaded: ${lineOf(error)}`);
      if (this.showing) {
        this.#picker.select(this.showing.session.entry.id);
      }
      return;
    }
    if (session) {
      this.#show(session);
    }
  }

  pick(number: number): void {
    const entry = this.#entries[number];
    if (entry) {
      void this.open(entry);
    }
  }

  nextCamera(): void {
    if (this.showing) {
      this.#bar.showCamera(this.showing.nextCamera());
    }
  }

  help(): void {
    this.#help.showModal();
  }

  #show(session: Session): void {
    this.#pointer.release();
    this.showing?.dispose();
    const showing = new Showing(session, this.#server?.live ?? null, this.#banners, this.#hud);
    this.showing = showing;
    this.#side.replaceChildren(...showing.side);
    if (this.#server) {
      this.#side.append(this.#server.train.element);
    }
    this.#side.scrollTop = 0;
    if (this.timeline) {
      this.timeline.follow(session.player);
    } else {
      this.timeline = new Timeline(session.player, () => this.showing?.goLive());
      document.body.append(this.timeline.element);
    }
    this.#bar.showCamera(session.world.camera.mode);
    this.#sticks.label(...steeredBy(session));
    this.#remember(session.entry);
    this.#last = performance.now();
    this.#image();
    this.#loading.hidden = true;
  }

  #fail(topic: string, line: string): void {
    this.#loading.hidden = true;
    this.#banners.say(topic, line, "error");
  }

  // A reload, or a shared address, shows the same.
  #remember(entry: CatalogueEntry): void {
    const address = new URL(location.href);
    address.searchParams.set("show", entry.id);
    history.replaceState(null, "", address);
    document.title = `${nameOf(entry)} – NeuroAnimator Studio`;
  }

  #add(catalogue: Catalogue): void {
    for (const entry of catalogue.entries) {
      if (!this.#entries.some((one) => one.id === entry.id)) {
        this.#entries.push(entry);
        this.#picker.add(entry);
      }
    }
  }

  async #reloadCatalogue(): Promise<void> {
    const catalogue = await loadCatalogue(this.#page).catch(() => null);
    if (catalogue) {
      this.#add(catalogue);
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

  #take(file: File): void {
    if (this.#server) {
      void this.#server.take(file);
    } else {
      this.#banners.say("upload", sayNoServer("Files are checked and prepared"), "warning");
    }
  }

  #toggleTheme(): void {
    toggleTheme();
    this.#redecorate();
  }

  // Only the studio floor has other colours in the dark theme; the sea looks the same.
  #redecorate(): void {
    const session = this.showing?.session;
    if (session?.facts.scene.kind === "plain") {
      void this.open(session.entry);
    }
  }

  #listen(stage: Stage): void {
    new ResizeObserver(() => stage.resize()).observe(this.#stageBox);
    this.#canvas.addEventListener("webglcontextlost", (event) => {
      event.preventDefault();
      this.#banners.say("webgl", "The graphics card was lost; the picture should return by itself. If not, reload the page.", "warning");
    });
    this.#canvas.addEventListener("webglcontextrestored", () => this.#banners.clear("webgl"));
    document.addEventListener("visibilitychange", () => (this.#last = performance.now()));
  }

  #hold(isHeld: boolean): void {
    if (this.showing) {
      this.showing.session.world.camera.controls.enabled = !isHeld;
    }
  }

  #image(): void {
    const now = performance.now();
    const seconds = Math.min((now - this.#last) / 1000, MAX_IMAGE);
    this.#last = now;
    if (this.showing) {
      this.showing.update(seconds, this.#keys);
      this.timeline?.update(seconds);
      document.documentElement.dataset["frames"] = String(++this.#images);
    }
  }
}
