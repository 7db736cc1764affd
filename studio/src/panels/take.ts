// Leave with something: files of the motion that is shown, and the lines that make the same elsewhere.

import { labelsOf } from "../bundle/layout";
import { button, element, panel } from "../page/dom";
import type { Banners } from "../page/banner";
import type { Session } from "../page/session";
import type { Live } from "../server/live";
import type { Panel } from "./controls";

const SERVER_FORMATS = ["glb", "usda", "mp4", "html"] as const;

/** Images a second of what the server writes. */
const RATE = 60;

/** Return the motion as CSV: time, controls and states, one super step a line, as `animate` writes it. */
export function motionCsv(session: Session): string {
  const { motion } = session.player;
  const { facts } = session;
  const head = ["time", ...labelsOf(facts.state), ...labelsOf(facts.control)].map((name) => name.replaceAll(" ", "."));
  const lines = [head.join(",")];
  for (let step = 0; step <= motion.steps; step++) {
    const control = motion.steps > 0 ? motion.control(Math.min(step, motion.steps - 1)) : facts.control_low;
    const numbers = [step * motion.dt, ...motion.state(step), ...control];
    lines.push(numbers.map((number) => Number(number.toPrecision(7))).join(","));
  }
  return `${lines.join("\n")}\n`;
}

/** Return only the controls as CSV, as `animate --controls` reads them. */
export function controlsCsv(session: Session): string {
  const { motion } = session.player;
  const lines = [["time", ...columnsOf(session)].join(",")];
  for (let step = 0; step < motion.steps; step++) {
    const numbers = [step * motion.dt, ...motion.control(step)];
    lines.push(numbers.map((number) => Number(number.toPrecision(7))).join(","));
  }
  return `${lines.join("\n")}\n`;
}

function columnsOf(session: Session): string[] {
  return session.facts.control.flatMap(([name, size]) =>
    size === 1 ? [name] : Array.from({ length: size }, (_, i) => `${name}_${i}`),
  );
}

/** Return the command line and the Python that make the shown motion, given its controls in a file. */
export function equivalentLines(session: Session): string {
  const { id } = session.facts;
  return [
    "# shell",
    `neuroanimator animate ${id} --controls controls.csv --out motion.glb`,
    "",
    "# Python",
    "import numpy as np",
    "import neuroanimator as na",
    "",
    `emulator = na.load_emulator("${id}")`,
    'controls = np.loadtxt("controls.csv", delimiter=",", skiprows=1, ndmin=2)[:, 1:]',
    "states = emulator.rollout(start, controls)  # start: the first line of motion.csv",
  ].join("\n");
}

export function takePanel(session: Session, live: Live | null, banners: Banners): Panel {
  const { details, body } = panel("Take with you", false);
  const save = (name: string, text: string): void => saveFile(name, new Blob([text], { type: "text/csv" }));
  const csv = button({ label: "CSV", title: "The motion as a table", onClick: () => save("motion.csv", motionCsv(session)) });
  const controls = button({
    label: "Controls",
    title: "The controls alone, as a table that 'neuroanimator animate' reads",
    onClick: () => save("controls.csv", controlsCsv(session)),
  });
  const formats = SERVER_FORMATS.map((format) => {
    const made = button({
      label: format.toUpperCase(),
      title: live ? `The motion as ${format}` : `${format} is written by the server: run 'neuroanimator studio'`,
      onClick: () => void exportBy(session, live!, format, banners, made),
    });
    made.disabled = live === null;
    return made;
  });
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
    element("div", "row", [...formats, csv, controls]),
    element("p", "", ["The same from a shell or Python:"]),
    code,
    element("div", "row", [copy]),
  );
  return { element: details, update: () => undefined };
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
    const wanted = { bundle: session.facts.id, format, rate: RATE, start: Array.from(motion.state(0)), controls };
    const answer = await live.post("api/exports", JSON.stringify(wanted), "application/json");
    const link = element("a");
    link.href = new URL(`api/downloads/${encodeURIComponent(String(answer["download"]))}`, document.baseURI).href;
    link.download = `${session.facts.id}.${format}`;
    link.click();
    banners.clear("export");
    banners.tell(`${format} is written.`);
  } catch (error) {
    banners.say("export", `No ${format}: ${error instanceof Error ? error.message : String(error)}`, "error");
  } finally {
    pressed.disabled = false;
  }
}

function saveFile(name: string, blob: Blob): void {
  const address = URL.createObjectURL(blob);
  const link = element("a");
  link.href = address;
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(address), 1000);
}
