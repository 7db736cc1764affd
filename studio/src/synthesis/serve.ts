// Descents as a message service, so that a worker can do them for a page.

import { descend, type Iteration } from "./descend";
import type { DescentFacts, Values } from "./facts";
import { DescentModule } from "./module";

/** A request for a descent. */
export interface Wanted {
  /** Initial state (S). */
  readonly start: ArrayLike<number>;
  readonly values?: Values;
  /** Variables (Z) of an earlier descent to begin with, instead of the initial guesses. */
  readonly guess?: ArrayLike<number>;
  /** Defects (T, V) from `correct`. */
  readonly defects?: ArrayLike<number>;
}

export type Request =
  | { readonly do: "open"; readonly id: number; readonly module: WebAssembly.Module; readonly facts: DescentFacts }
  | { readonly do: "descend"; readonly id: number; readonly wanted: Wanted }
  | { readonly do: "correct"; readonly id: number; readonly states: Float32Array; readonly controls: Float32Array }
  | { readonly do: "stop"; readonly id: number };

export type Answer =
  | { readonly id: number; readonly iteration: Iteration }
  | { readonly id: number; readonly defects: Float32Array }
  | { readonly id: number; readonly done: true }
  | { readonly id: number; readonly error: string };

/** One end of a channel: a worker's `self`, a `Worker`, or a `MessagePort`. */
export interface Port {
  postMessage(message: unknown): void;
  onmessage: ((event: MessageEvent) => void) | null;
}

/** Answer the requests from `port`, one after the other; a descent may be stopped meanwhile. */
export function serve(port: Port): void {
  const stopped = new Set<number>();
  let opened: DescentModule | undefined;
  let before = Promise.resolve();

  const answer = (message: Answer): void => port.postMessage(message);

  async function handle(request: Exclude<Request, { do: "stop" }>): Promise<void> {
    const { id } = request;
    if (request.do === "open") {
      opened = await DescentModule.start(request.module, request.facts);
      return answer({ id, done: true });
    }
    if (opened === undefined) {
      throw new Error("the descent was not opened");
    }
    if (request.do === "correct") {
      return answer({ id, defects: opened.defectsOf(request.states, request.controls) });
    }
    const { start, values, guess, defects } = request.wanted;
    opened.pose(start, values, defects);
    for (const iteration of descend(opened, guess === undefined ? undefined : [guess])) {
      if (stopped.delete(id)) {
        break;
      }
      answer({ id, iteration });
      await pause();
    }
    answer({ id, done: true });
  }

  port.onmessage = (event: MessageEvent): void => {
    const request = event.data as Request;
    if (request.do === "stop") {
      stopped.add(request.id);
      return;
    }
    before = before.then(() =>
      handle(request).catch((error: unknown) => answer({ id: request.id, error: String(error) })),
    );
  };
}

/** Let messages in. Timers would wait for milliseconds. */
function pause(): Promise<void> {
  return new Promise((resume) => {
    const { port1, port2 } = new MessageChannel();
    port1.onmessage = () => {
      port1.close();
      resume();
    };
    port2.postMessage(null);
  });
}
