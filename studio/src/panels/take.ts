// Export: files of the shown motion, and the lines that make the same elsewhere.

import { base64Of } from "../bundle/base64";
import { isOwn, isPhysics, type Bundle } from "../bundle/bundle";
import type { Layout } from "../bundle/layout";
import { button, element, panel } from "../page/dom";
import { lineOf, type Banners } from "../page/banner";
import type { Film } from "../page/film";
import type { Session } from "../page/session";
import { sayNoServer } from "../server/advice";
import type { Live } from "../server/live";
import type { WalkPilot } from "../steering/pilots";
import type { Panel } from "./controls";

const SERVER_FORMATS = ["glb", "usda", "html"] as const;

/** Frame rate of the server's files [images per second]. */
const RATE = 60;

/** Maximum number of parts of a start that fit on a command line. */
const MAX_START_OPTIONS = 6;

/** Return the states as CSV, one super step a line. */
export function motionCsv(session: Session): string {
  const { motion } = session.player;
  const { facts } = session;
  const lines = [headOf(facts.state)];
  for (let step = 0; step <= motion.steps; step++) {
    lines.push(rowOf(step * motion.dt, motion.state(step)));
  }
  return `${lines.join("\n")}\n`;
}

/** Return only the controls as CSV, as `animate --controls` reads them. */
export function controlsCsv(session: Session): string {
  const { motion } = session.player;
  const lines = [headOf(session.facts.control)];
  for (let step = 0; step < motion.steps; step++) {
    lines.push(rowOf(step * motion.dt, motion.control(step)));
  }
  return `${lines.join("\n")}\n`;
}

/** The first line, as `neuroanimator` itself writes and reads it (export/csv_file.py). */
function headOf(layout: Layout): string {
  const columns = layout.flatMap(([name, size, unit]) =>
    Array.from({ length: size }, (_, i) => cell(`${name}[${i}] ${unit}`)),
  );
  return ["time s", ...columns].join(",");
}

/** A name as a cell: quoted where it must be, and never a formula to a spreadsheet. */
function cell(name: string): string {
  const harmless = /^[=+\-@]/.test(name) ? `'${name}` : name;
  return /[",\n]/.test(harmless) ? `"${harmless.replaceAll('"', '""')}"` : harmless;
}

function rowOf(time: number, numbers: Float32Array): string {
  const all = [time, ...numbers];
  return all.map((number) => String(Number(number.toPrecision(8)))).join(",");
}

/** Return the command line and the Python that make the shown motion, given its controls in a file. */
export function equivalentLines(session: Session): string {
  const { system } = session.facts;
  const id = referenceOf(session.facts);
  if (isPhysics(session.facts)) {
    const train = `neuroanimator train ${system} --out ${system}.emulator.safetensors`;
    return [...physicsLines(session), "", "# shell: an emulator of it, to animate, export and control", train].join("\n");
  }
  if (session.walker) {
    return walkerLines(session.walker).join("\n");
  }
  const isByPhysics = session.player.motion.source === "physics";
  const shell = [
    "# shell",
    `neuroanimator animate ${id} --controls controls.csv \\`,
    ...startOptions(session).map((option) => `  --start ${option} \\`),
    ...(isByPhysics ? ["  --hybrid --threshold 0 \\"] : []),
    "  --out motion.glb",
    "",
  ];
  return [...shell, ...(isByPhysics ? physicsLines(session) : emulatorLines(id))].join("\n");
}

/** The emulator's name for `neuroanimator`: that of a file for one that does not ship. */
function referenceOf(facts: Bundle): string {
  return isOwn(facts.id) ? `${facts.system}.emulator.safetensors` : facts.id;
}

function emulatorLines(id: string): string[] {
  return [
    "# Python",
    "from pathlib import Path",
    "",
    "import numpy as np",
    "",
    "import neuroanimator as na",
    "",
    `emulator = na.load_emulator("${id}")`,
    'start = np.loadtxt("motion.csv", delimiter=",", skiprows=1)[0, 1:]',
    'controls = np.loadtxt("controls.csv", delimiter=",", skiprows=1, ndmin=2)[:, 1:]',
    "states = emulator.rollout(start, controls)",
    'clip = na.make_clip(emulator, states, rate=60, source="emulator")',
    'na.write_glb(clip, Path("motion.glb"))',
  ];
}

/** The line that walks with the current commands, by the file of its bundle. */
function walkerLines({ command }: WalkPilot): string[] {
  const told = `10,${command.speed.toFixed(2)},${command.turning.toFixed(2)}`;
  return ["# shell", `neuroanimator animate human.policy.safetensors --command ${told} \\`, "  --in-emulator --out motion.glb"];
}

/** The same for a motion of the physics. */
function physicsLines(session: Session): string[] {
  const { system, dt } = session.facts;
  return [
    "# Python",
    "import numpy as np",
    "",
    "import neuroanimator as na",
    "",
    `system = na.load_system("${system}")`,
    'start = np.loadtxt("motion.csv", delimiter=",", skiprows=1)[0, 1:]',
    'controls = np.loadtxt("controls.csv", delimiter=",", skiprows=1, ndmin=2)[:, 1:]',
    `runs = system.simulate(start[None], controls[None], dt=${dt})`,
    "states = runs.states[0]",
  ];
}

/** Parts of the start that differ from rest, for `--start`; none for a body of many points, which Python has in full. */
function startOptions(session: Session): string[] {
  const { facts, player } = session;
  const start = player.motion.state(0);
  const options: string[] = [];
  let entry = 0;
  for (const [name, size] of facts.state) {
    const numbers = Array.from(start.subarray(entry, entry + size));
    const isElsewhere = numbers.some((number, i) => Math.abs(number - facts.rest[entry + i]!) > 1e-6);
    if (isElsewhere) {
      options.push(`${name}=${numbers.map((number) => Number(number.toPrecision(6))).join(",")}`);
    }
    entry += size;
  }
  return options.length <= MAX_START_OPTIONS ? options : [];
}

/** Makes a film of the shown motion, and reports the share done. */
export type Filming = (onProgress: (share: number) => void, signal: AbortSignal) => Promise<Film>;

export function takePanel(session: Session, live: Live | null, banners: Banners, makeFilm: Filming): Panel {
  const { details, body } = panel("Export", false);
  const save = (name: string, text: string): void => saveFile(name, new Blob([text], { type: "text/csv" }));
  const film = button({
    label: "Film",
    title: "A film of the motion, through the current camera",
    onClick: () => void saveFilm(fileNameOf(session.facts), makeFilm, banners),
  });
  const csv = button({ label: "CSV", title: "The motion as a table", onClick: () => save("motion.csv", motionCsv(session)) });
  const controls = button({
    label: "Controls",
    title: "The controls alone, as a table that 'neuroanimator animate' reads",
    onClick: () => save("controls.csv", controlsCsv(session)),
  });
  const formats = SERVER_FORMATS.map((format) => {
    const made = button({
      label: format.toUpperCase(),
      title: live ? `The motion as ${format}` : sayNoServer(`${format} is written`),
      onClick: () => void exportBy(session, live!, format, banners, made),
    });
    made.disabled = live === null;
    return made;
  });
  const pushed = element("p", "", ["Pushes with the mouse, and commands that are part of the state, are not in these lines; motion.csv has every state."]);
  const code = element("pre", "code", [equivalentLines(session)]);
  code.tabIndex = 0;
  const copy = button({
    label: "Copy",
    title: "Copy these lines",
    onClick() {
      navigator.clipboard.writeText(code.textContent ?? "").then(
        () => banners.tell("Copied."),
        () => banners.tell("The browser does not let this page copy: select the lines instead.", "warning"),
      );
    },
  });
  body.append(
    element("div", "row", [film, ...formats, csv, controls]),
    element("p", "", ["The same from a shell or Python:"]),
    code,
    element("div", "row", [copy]),
    pushed,
  );
  let shown = session.player.motion;
  details.addEventListener("toggle", () => (code.textContent = equivalentLines(session)));
  return {
    element: details,
    update() {
      pushed.hidden = session.player.motion.pushes().length === 0;
      if (shown !== session.player.motion) {
        shown = session.player.motion;
        code.textContent = equivalentLines(session);
      }
    },
  };
}

/** Make and save a film while nothing else can be pressed; Escape and a button cancel it. */
async function saveFilm(name: string, makeFilm: Filming, banners: Banners): Promise<void> {
  const cancelled = new AbortController();
  const share = element("progress");
  const left = element("output", "clock");
  const began = performance.now();
  const cancel = button({ label: "Cancel", onClick: () => dialog.close() });
  const dialog = element("dialog", "filming", ["Filming", share, left, cancel]);
  dialog.addEventListener("close", () => cancelled.abort());
  document.body.append(dialog);
  dialog.showModal();
  try {
    const film = await makeFilm((done) => {
      share.value = done;
      left.textContent = timeLeft(done, (performance.now() - began) / 1000);
    }, cancelled.signal);
    saveFile(`${name}${film.ending}`, film.blob);
    banners.tell("The film is written.");
  } catch (error) {
    if (!cancelled.signal.aborted) {
      banners.say("export", `No film: ${lineOf(error)}`, "error");
    }
  } finally {
    dialog.remove();
  }
}

/** Return the remaining time in words, when a share of the work is `done` after `seconds`. */
export function timeLeft(done: number, seconds: number): string {
  if (done <= 0) {
    return "";
  }
  const left = Math.ceil((seconds / done) * (1 - done));
  return left < 60 ? `${left} s left` : `${Math.floor(left / 60)} min ${left % 60} s left`;
}

async function exportBy(
  session: Session,
  live: Live,
  format: string,
  banners: Banners,
  pressed: HTMLButtonElement,
): Promise<void> {
  const { motion } = session.player;
  pressed.disabled = true;
  banners.say("export", `Writing ${format} …`);
  try {
    const controls = Array.from({ length: motion.steps }, (_, step) => Array.from(motion.control(step)));
    const wanted = {
      bundle: session.facts.id,
      format,
      rate: RATE,
      start: Array.from(motion.state(0)),
      controls,
      pushes: motion.pushes(),
      source: motion.source,
      // With another program's rounding a walk would soon differ, and fall.
      ...(session.walker ? { states: base64Of(motion.states()) } : {}),
    };
    const answer = await live.post("api/exports", JSON.stringify(wanted), "application/json");
    const link = element("a");
    link.href = new URL(`api/downloads/${encodeURIComponent(String(answer["download"]))}`, document.baseURI).href;
    link.download = `${fileNameOf(session.facts)}.${format}`;
    link.click();
    banners.clear("export");
    banners.tell(`${format} is written.`);
  } catch (error) {
    banners.say("export", `No ${format}: ${lineOf(error)}`, "error");
  } finally {
    pressed.disabled = false;
  }
}

/** Name of a file of the shown motion, without its suffix. */
function fileNameOf(facts: Bundle): string {
  return isOwn(facts.id) ? facts.system : facts.id;
}

function saveFile(name: string, blob: Blob): void {
  const address = URL.createObjectURL(blob);
  const link = element("a");
  link.href = address;
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(address), 1000);
}
