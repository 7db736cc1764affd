// Training from the page: choose a system or drop a model, watch data and loss, stop and resume. The server does the work.

import { button, element, panel } from "../page/dom";
import { lineOf, type Banners } from "../page/banner";
import type { Answer, Live } from "../server/live";
import { Curve } from "./curve";

const SIZES = ["sketch", "usual", "large"] as const;

/** Numbers of physics steps in a leap, to choose from. */
const SUBSTEPS = [25, 50, 100] as const;

/** Pattern of model files; any other dropped file is taken for an emulator. */
const MODEL_FILES = /\.(xml|mjcf|urdf)$/i;

/** A training, as reported by the server. */
interface Job {
  readonly id: string;
  readonly system: string;
  readonly substeps: number;
  readonly size: string;
  readonly phase: string;
  readonly done: number;
  readonly of: number;
  readonly is_running: boolean;
  readonly curve?: readonly (readonly number[])[];
  readonly words?: string;
  readonly bundle?: string;
}

interface JobRow {
  readonly row: HTMLElement;
  show(job: Job): void;
}

export function isModelFile(name: string): boolean {
  return MODEL_FILES.test(name);
}

export class TrainPanel {
  readonly element: HTMLElement;
  readonly #list = element("div", "jobs");
  readonly #system = element("select");
  readonly #rows = new Map<string, JobRow>();

  constructor(
    private readonly live: Live,
    private readonly banners: Banners,
    systems: readonly string[],
    private readonly onShow: (id: string) => void,
  ) {
    const { details, body } = panel("Train", false);
    this.element = details;
    const substeps = choice("Physics steps per leap", SUBSTEPS.map(String), "50");
    const size = choice("Size", SIZES, "usual");
    this.#system.setAttribute("aria-label", "System");
    systems.forEach((system) => this.#addSystem(system, system));
    const begin = button({
      label: "Train",
      title: "Simulate, then train an emulator; training continues if the page is closed",
      className: "primary",
      onClick: () => void this.#begin(Number(substeps.value), size.value),
    });
    body.append(
      element("p", "", ["Train an emulator on this machine; or drop a MuJoCo model (.xml, .urdf) on the page first."]),
      element("div", "row", [this.#system, substeps, size, begin]),
      this.#list,
    );
    details.addEventListener("toggle", () => {
      if (details.open) {
        void this.#ask("jobs", {});
      }
    });
  }

  /** Show the server's report of a training. */
  tell(event: Answer): void {
    this.#show(event as unknown as Job);
  }

  /** Send a dropped model, and offer it for training. */
  async addModel(file: File): Promise<void> {
    this.banners.say("upload", `Reading ${file.name} …`);
    try {
      const stem = file.name.replace(MODEL_FILES, "");
      const answer = await this.live.post("api/models", file, "application/octet-stream", { "X-Name": encodeURIComponent(stem) });
      this.#addSystem(`model:${String(answer["model"])}`, String(answer["system"]));
      this.#system.value = `model:${String(answer["model"])}`;
      (this.element as HTMLDetailsElement).open = true;
      this.element.scrollIntoView({ block: "nearest" });
      const warnings = (answer["warnings"] as string[] | undefined) ?? [];
      this.banners.say("upload", [`${file.name} is read: press Train.`, ...warnings].join(" "), warnings.length > 0 ? "warning" : "info");
    } catch (error) {
      this.banners.say("upload", `${file.name}: ${lineOf(error)}`, "error");
    }
  }

  #addSystem(value: string, label: string): void {
    const option = element("option", "", [label]);
    option.value = value;
    this.#system.append(option);
  }

  #begin(substeps: number, size: string): Promise<void> {
    const { value } = this.#system;
    const what = value.startsWith("model:") ? { model: value.slice("model:".length) } : { system: value };
    return this.#ask("train", { ...what, substeps, size });
  }

  async #ask(what: string, parameters: Answer): Promise<void> {
    try {
      const answer = await this.live.ask(what, parameters);
      const jobs = (answer["jobs"] as Job[] | undefined) ?? [];
      const present = new Set(jobs.map((job) => job.id));
      this.#rows.forEach((row, id) => {
        if (!present.has(id)) {
          row.row.remove();
          this.#rows.delete(id);
        }
      });
      jobs.forEach((job) => this.#show(job));
      this.banners.clear("train");
    } catch (error) {
      this.banners.say("train", `Training: ${lineOf(error)}`, "error");
    }
  }

  #show(job: Job): void {
    let row = this.#rows.get(job.id);
    if (!row) {
      row = this.#makeRow(job.id);
      this.#rows.set(job.id, row);
      this.#list.prepend(row.row);
    }
    row.show(job);
  }

  #makeRow(id: string): JobRow {
    const title = element("strong");
    const said = element("span", "said");
    const bar = element("progress");
    const curve = new Curve("error while training");
    let bundle: string | undefined;
    const stop = button({ label: "Stop", title: "Stop this training; it can be resumed", onClick: () => void this.#ask("stop", { job: id }) });
    const resume = button({ label: "Resume", title: "Continue this training", onClick: () => void this.#ask("resume", { job: id }) });
    const forget = button({ label: "Forget", title: "Delete this training and its data", onClick: () => void this.#ask("forget", { job: id }) });
    const show = button({ label: "Show", title: "Put this emulator on the stage", className: "primary", onClick: () => bundle && this.onShow(bundle) });
    const row = element("div", "job", [title, said, bar, curve.element, element("div", "row", [show, stop, resume, forget])]);
    return {
      row,
      show(job) {
        bundle = job.bundle;
        title.textContent = `${job.system}, ${job.substeps} steps, ${job.size}`;
        said.textContent = job.words ?? job.phase;
        bar.max = Math.max(job.of, 1);
        bar.value = job.done;
        show.hidden = job.bundle === undefined;
        stop.hidden = !job.is_running;
        resume.hidden = job.is_running || job.phase === "done";
        forget.hidden = job.is_running;
        const errors = (job.curve ?? []).map((point) => Math.log10(Math.max(point[2] ?? point[1] ?? 1, 1e-9)));
        curve.element.hidden = errors.length < 2;
        if (errors.length >= 2) {
          curve.draw([{ values: errors, colour: "--accent" }], errors.length, Math.min(...errors), Math.max(...errors));
          curve.note = (10 ** errors.at(-1)!).toPrecision(2);
        }
      },
    };
  }
}

function choice(label: string, values: readonly string[], chosen: string): HTMLSelectElement {
  const select = element("select");
  select.setAttribute("aria-label", label);
  select.title = label;
  for (const value of values) {
    select.append(element("option", "", [value]));
  }
  select.value = chosen;
  return select;
}
