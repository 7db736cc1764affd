// The connection to the server, if there is one: requests and answers, events, and reconnection.

import { fetchOwn, openSocket } from "./token";

/** Delays before reconnecting, one after the other; the last is repeated [s]. */
const WAITS = [0.5, 1, 2, 4, 8];

/** Maximum time to wait for an answer [s]: physics may be slow. */
const PATIENCE = 60;

export type Answer = Record<string, unknown>;

interface Waiting {
  resolve(answer: Answer): void;
  reject(error: Error): void;
}

export class Live {
  /** Called when the connection opens or is lost. */
  onState: (isOpen: boolean) => void = () => undefined;
  /** Called with the server's events. */
  onEvent: (event: Answer) => void = () => undefined;

  #socket: WebSocket | null = null;
  #next = 1;
  #tries = 0;
  #isClosed = false;
  readonly #waiting = new Map<number, Waiting>();

  constructor(private readonly page: URL) {}

  get isOpen(): boolean {
    return this.#socket?.readyState === WebSocket.OPEN;
  }

  /** Open the connection, again whenever it is lost. */
  connect(): void {
    const address = new URL("live", this.page);
    address.protocol = address.protocol === "https:" ? "wss:" : "ws:";
    const socket = openSocket(address);
    this.#socket = socket;
    socket.onopen = () => {
      this.#tries = 0;
      this.onState(true);
    };
    socket.onmessage = (message) => this.#receive(String(message.data));
    socket.onclose = () => this.#lost();
  }

  /** Ask the server to do something; the error is one clear line. */
  ask(what: string, parameters: Answer = {}): Promise<Answer> {
    if (!this.isOpen) {
      return Promise.reject(new Error("the server does not answer; start it again with 'neuroanimator studio'"));
    }
    const id = this.#next++;
    return new Promise((resolve, reject) => {
      const timer = setTimeout(() => {
        this.#waiting.delete(id);
        reject(new Error(`the server took longer than ${PATIENCE} s`));
      }, 1000 * PATIENCE);
      this.#waiting.set(id, {
        resolve: (answer) => (clearTimeout(timer), resolve(answer)),
        reject: (error) => (clearTimeout(timer), reject(error)),
      });
      this.#socket!.send(JSON.stringify({ ...parameters, id, do: what }));
    });
  }

  /** Send bytes or JSON to one of the server's addresses; the error is the server's own line. */
  async post(path: string, body: BodyInit, type: string, headers: Record<string, string> = {}): Promise<Answer> {
    const response = await fetchOwn(new URL(path, this.page), {
      method: "POST",
      headers: { ...headers, "Content-Type": type },
      body,
    });
    return (await response.json()) as Answer;
  }

  close(): void {
    this.#isClosed = true;
    this.#socket?.close();
  }

  #receive(text: string): void {
    const message = JSON.parse(text) as Answer;
    if (typeof message["event"] === "string") {
      this.onEvent(message);
      return;
    }
    const waiting = this.#waiting.get(Number(message["id"]));
    if (!waiting) {
      return;
    }
    this.#waiting.delete(Number(message["id"]));
    if (typeof message["error"] === "string") {
      waiting.reject(new Error(message["error"]));
    } else {
      waiting.resolve(message);
    }
  }

  #lost(): void {
    this.#waiting.forEach((waiting) => waiting.reject(new Error("the server was lost before it answered")));
    this.#waiting.clear();
    if (this.#isClosed) {
      return;
    }
    this.onState(false);
    const wait = WAITS[Math.min(this.#tries, WAITS.length - 1)]!;
    this.#tries += 1;
    setTimeout(() => this.connect(), 1000 * wait);
  }
}
