// The true physics, computed by the server.

import { floatsOf } from "../bundle/base64";
import type { Bundle } from "../bundle/bundle";
import type { Live } from "../server/live";
import type { Drive, Physics, Replay } from "./physics";

export class ServerPhysics implements Physics {
  constructor(
    private readonly live: Live,
    private readonly facts: Bundle,
  ) {}

  get isReady(): boolean {
    return this.live.isOpen;
  }

  async replay(drive: Drive): Promise<Replay> {
    const answer = await this.live.ask("replay", {
      bundle: this.facts.id,
      start: Array.from(drive.start),
      controls: rowsOf(drive.controls, this.facts.control_low.length),
      pushes: drive.pushes,
    });
    const seconds = Number(answer["wall_s"]);
    const usualSeconds = Number(answer["usual_wall_s"] ?? seconds);
    return { states: floatsOf(String(answer["states"])), seconds, usualSeconds };
  }
}

function rowsOf(numbers: Float32Array, size: number): number[][] {
  const rows: number[][] = [];
  for (let first = 0; first < numbers.length; first += size) {
    rows.push(Array.from(numbers.subarray(first, first + size)));
  }
  return rows;
}
