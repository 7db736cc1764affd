// The timeline: play, scrub, slow motion, one super step at a time; it marks where not to trust the emulator.

import { button, element } from "../page/dom";
import { EDGE } from "../motion/motion";
import type { Player } from "../motion/player";

const SPEEDS = [0.1, 0.25, 0.5, 1, 2] as const;

/** Minimum interval between redraws of the bar [s]. */
const STRIP_INTERVAL = 0.25;

export class Timeline {
  readonly element: HTMLElement;
  readonly #play: HTMLButtonElement;
  readonly #range: HTMLInputElement;
  readonly #clock = element("output", "clock");
  readonly #speed = element("select");
  readonly #strip = element("canvas", "strip");
  readonly #live: HTMLButtonElement;
  #waited = Infinity;

  constructor(
    private player: Player,
    private readonly onLive: () => void,
  ) {
    this.#play = button({ label: "▶", title: "Play or pause (space)", className: "play", onClick: () => this.toggle() });
    const back = button({ label: "|◂", title: "To the start (Home)", onClick: () => this.player.seek(0) });
    const before = button({ label: "◂", title: "One super step back (,)", onClick: () => this.player.stepBy(-1) });
    const after = button({ label: "▸", title: "One super step forward (.)", onClick: () => this.player.stepBy(1) });
    this.#live = button({ label: "Live", title: "Continue with the emulator from here (L)", className: "live", onClick: () => this.onLive() });
    this.#range = element("input", "scrub");
    this.#range.type = "range";
    this.#range.min = "0";
    this.#range.step = "any";
    this.#range.setAttribute("aria-label", "Time");
    this.#range.addEventListener("input", () => {
      this.player.isPlaying = false;
      this.player.seek(Number(this.#range.value));
    });
    this.#speed.setAttribute("aria-label", "Speed");
    for (const speed of SPEEDS) {
      const option = element("option", "", [`${speed}×`]);
      option.value = String(speed);
      this.#speed.append(option);
    }
    this.#speed.value = "1";
    this.#speed.addEventListener("change", () => (this.player.speed = Number(this.#speed.value)));
    const track = element("div", "track", [this.#strip, this.#range]);
    this.element = element("footer", "timeline", [
      element("div", "transport", [back, before, this.#play, after]),
      track,
      this.#clock,
      this.#speed,
      this.#live,
    ]);
  }

  /** Go on with another player. */
  follow(player: Player): void {
    player.speed = this.player.speed;
    this.player = player;
    this.#waited = Infinity;
  }

  toggle(): void {
    const { player } = this;
    const isAtEnd = !player.isLive && player.time >= player.motion.duration;
    if (!player.isPlaying && isAtEnd) {
      player.seek(0);
    }
    player.isPlaying = !player.isPlaying;
  }

  /** Change the speed by `steps` steps. */
  changeSpeed(steps: number): void {
    const present = SPEEDS.findIndex((speed) => speed === this.player.speed);
    const next = Math.min(Math.max((present < 0 ? 3 : present) + steps, 0), SPEEDS.length - 1);
    this.player.speed = SPEEDS[next]!;
    this.#speed.value = String(SPEEDS[next]);
  }

  update(seconds: number): void {
    const { player } = this;
    const duration = Math.max(player.motion.duration, player.motion.dt);
    setText(this.#play, player.isPlaying ? "❚❚" : "▶");
    setAttribute(this.#play, "aria-pressed", String(player.isPlaying));
    setAttribute(this.#live, "aria-pressed", String(player.isLive));
    setAttribute(this.#range, "max", String(duration));
    this.#range.value = String(player.time);
    setText(this.#clock, `${player.time.toFixed(2)} / ${duration.toFixed(2)} s`);
    this.#waited += seconds;
    if (this.#waited > STRIP_INTERVAL) {
      this.#waited = 0;
      this.#drawStrip();
    }
  }

  // Beyond the edge of training the bar has the colour of doubt.
  #drawStrip(): void {
    const { motion } = this.player;
    const width = this.#strip.clientWidth;
    if (width === 0) {
      return;
    }
    this.#strip.width = width;
    this.#strip.height = 1;
    const context = this.#strip.getContext("2d")!;
    const style = getComputedStyle(this.#strip);
    const trusted = style.getPropertyValue("--accent");
    const doubtful = style.getPropertyValue("--doubt");
    for (let x = 0; x < width; x++) {
      const step = Math.min(Math.floor((x / width) * motion.steps), motion.steps - 1);
      context.fillStyle = step >= 0 && motion.score(step) > EDGE ? doubtful : trusted;
      context.fillRect(x, 0, 1, 1);
    }
  }
}

function setText(node: HTMLElement, text: string): void {
  if (node.textContent !== text) {
    node.textContent = text;
  }
}

function setAttribute(node: HTMLElement, name: string, value: string): void {
  if (node.getAttribute(name) !== value) {
    node.setAttribute(name, value);
  }
}
