// The server's services for the whole page: it reports trainings and new emulators, and takes files.

import { lineOf, type Banners } from "../page/banner";
import { isModelFile, TrainPanel } from "../panels/train";
import { Live, type Answer } from "./live";

/** The page's actions on news from the server. */
export interface ServerUses {
  /** Shipped systems. */
  readonly systems: readonly string[];
  /** The catalogue has changed. */
  reloadCatalogue(): Promise<void>;
  /** Show the emulator of a bundle, which may be new. */
  show(id: string): Promise<void>;
}

export class Server {
  readonly live: Live;
  readonly train: TrainPanel;

  /** Open the connection to the page's server. */
  constructor(
    page: URL,
    private readonly banners: Banners,
    private readonly uses: ServerUses,
  ) {
    this.live = new Live(page);
    this.live.onState = (isOpen) => this.#sayState(isOpen);
    this.live.onEvent = (event) => this.#told(event);
    this.train = new TrainPanel(this.live, banners, uses.systems, (id) => void uses.show(id));
    this.live.connect();
  }

  /** Take a file of the user's: a model to train, or an emulator to show. */
  async take(file: File): Promise<void> {
    if (isModelFile(file.name)) {
      await this.train.addModel(file);
      return;
    }
    this.banners.say("upload", `Reading ${file.name} …`);
    try {
      const answer = await this.live.post("api/emulators", file, "application/octet-stream");
      await this.uses.show(String(answer["id"]));
      this.banners.clear("upload");
    } catch (error) {
      this.banners.say("upload", `${file.name}: ${lineOf(error)}`, "error");
    }
  }

  #sayState(isOpen: boolean): void {
    if (isOpen) {
      this.banners.clear("server");
    } else {
      this.banners.say("server", "The server does not answer; the emulator goes on without it. Start it again with 'neuroanimator studio'.", "warning");
    }
  }

  // Handles the server's events.
  #told(event: Answer): void {
    if (event["event"] === "job") {
      this.train.tell(event);
    } else if (event["event"] === "emulator") {
      this.banners.say("upload", `The emulator: ${String(event["phase"])} …`);
    } else if (event["event"] === "catalogue") {
      void this.uses.reloadCatalogue();
    }
  }
}
