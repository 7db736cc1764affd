// The page's interface to descents, which a worker does, iteration by iteration.

import type { Iteration } from "./descend";
import type { DescentFacts } from "./facts";
import type { Answer, Port, Request, Wanted } from "./serve";

type Question = Request extends infer One ? (One extends Request ? Omit<One, "id"> : never) : never;

/** Return the port of a new worker. */
export function startWorker(): Worker {
  return new Worker(new URL("./worker.ts", import.meta.url), { type: "module" });
}

/** A worker, or a stand-in. */
export type WorkerPort = Port & { terminate?(): void; onerror?: unknown };

export class Synthesiser {
  #lastId = 0;
  readonly #listeners = new Map<number, (answer: Answer) => void>();
  readonly #opened: Promise<unknown>;

  /** `port` leads to a worker that `serve`s; `module` is the compiled file named in `facts`. */
  constructor(
    readonly facts: DescentFacts,
    module: WebAssembly.Module,
    private readonly port: WorkerPort = startWorker(),
  ) {
    // A worker that fails to load, or runs out of memory, does not answer.
    port.onerror = (): void => {
      const error = "the optimising worker was stopped; reload the page";
      [...this.#listeners].forEach(([id, listener]) => listener({ id, error }));
    };
    port.onmessage = (event: MessageEvent): void => {
      const answer = event.data as Answer;
      this.#listeners.get(answer.id)?.(answer);
    };
    this.#opened = this.#ask({ do: "open", module, facts } as Question);
    this.#opened.catch(() => undefined); // `descend` reports it
  }

  /** Yield every iteration of a descent, the initial guess included; it ends early once `signal` is aborted. */
  async *descend(wanted: Wanted, signal?: AbortSignal): AsyncGenerator<Iteration, void> {
    await this.#opened;
    const id = ++this.#lastId;
    const answers: Answer[] = [];
    let wake = (): void => undefined;
    const onAbort = (): void => wake();
    this.#listeners.set(id, (answer) => {
      answers.push(answer);
      wake();
    });
    signal?.addEventListener("abort", onAbort);
    this.#send({ do: "descend", id, wanted });
    let isOver = false;
    try {
      while (!signal?.aborted) {
        const answer = answers.shift();
        if (answer === undefined) {
          await new Promise<void>((resume) => (wake = resume));
        } else if ("iteration" in answer) {
          yield answer.iteration;
        } else {
          isOver = true;
          if ("error" in answer) {
            throw new Error(answer.error);
          }
          return;
        }
      }
    } finally {
      signal?.removeEventListener("abort", onAbort);
      this.#listeners.delete(id);
      if (!isOver) {
        this.#send({ do: "stop", id });
      }
    }
  }

  /** Return the defects that make the emulator follow the physics' `states` (T + 1, S) under `controls` (T, C) from now on. */
  async correct(states: Float32Array, controls: Float32Array): Promise<Float32Array> {
    await this.#opened;
    const answer = await this.#ask({ do: "correct", states, controls } as Question);
    return (answer as { defects: Float32Array }).defects;
  }

  dispose(): void {
    this.port.terminate?.();
    this.#listeners.clear();
  }

  #ask(question: Question): Promise<Answer> {
    const id = ++this.#lastId;
    return new Promise((resolve, reject) => {
      this.#listeners.set(id, (answer) => {
        this.#listeners.delete(id);
        if ("error" in answer) {
          reject(new Error(answer.error));
        } else {
          resolve(answer);
        }
      });
      this.#send({ ...question, id } as Request);
    });
  }

  #send(request: Request): void {
    this.port.postMessage(request);
  }
}
