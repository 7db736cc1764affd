// What a page asks for descents: they are done in a worker, and come iteration by iteration.

import type { Iteration } from "./descend";
import type { DescentFacts } from "./facts";
import type { Answer, Port, Request, Wanted } from "./serve";

type Question = Request extends infer One ? (One extends Request ? Omit<One, "id"> : never) : never;

/** Return the port of a new worker. */
export function startWorker(): Worker {
  return new Worker(new URL("./worker.ts", import.meta.url), { type: "module" });
}

/** A worker, or what stands for one. */
export type WorkerPort = Port & { terminate?(): void; onerror?: unknown };

export class Synthesiser {
  #lastId = 0;
  readonly #listeners = new Map<number, (answer: Answer) => void>();
  readonly #opened: Promise<unknown>;

  /** `port` leads to what `serve`s: a worker; `module` is the compiled file that `facts` name. */
  constructor(
    readonly facts: DescentFacts,
    module: WebAssembly.Module,
    private readonly port: WorkerPort = startWorker(),
  ) {
    // A worker that is not loaded, or that runs out of memory, answers nobody.
    port.onerror = (): void => {
      const error = "the worker that descends was stopped; reload the page";
      [...this.#listeners].forEach(([id, listener]) => listener({ id, error }));
    };
    port.onmessage = (event: MessageEvent): void => {
      const answer = event.data as Answer;
      this.#listeners.get(answer.id)?.(answer);
    };
    this.#opened = this.#ask({ do: "open", module, facts } as Question);
    this.#opened.catch(() => undefined); // whoever descends is told
  }

  /** Yield every iteration of a descent, the first guess included; it ends early once `signal` is aborted. */
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

  /** Return what makes the emulator go through `states` (T + 1, S) of the physics: for the next descent under `controls` (T, C). */
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
