"""The WebAssembly module that users export, in node: a process that takes the time itself, one run for each line it reads."""

from __future__ import annotations

import json
import shutil
import subprocess
from collections.abc import Iterator
from contextlib import ExitStack
from functools import partial
from pathlib import Path

from benchmarks.super_steps.case import (
    BATCH_STEPS,
    BATCHES,
    GRADIENT,
    GRADIENT_STEPS,
    STEPS,
    SUPER_STEP,
    Case,
    Motion,
    batch_task,
)
from neuroanimator.errors import ResourceError

NAME = "WASM in node"

SCRIPT = """
import { readFileSync } from "node:fs";
import { createInterface } from "node:readline";
import { load } from "./it.js";

const { controls, size, gradientSteps, batchSteps } = JSON.parse(readFileSync("motion.json"));
const emulator = await load(readFileSync("it.wasm"));
const all = Float32Array.from(controls.flat());
const start = emulator.rest;
const batches = new Map();

function roomFor(count) {
  if (!batches.has(count)) {
    const batch = emulator.batch(count);
    for (let body = 0; body < count; body++) {
      batch.controls.set(controls[body % controls.length], body * size);
    }
    batches.set(count, batch);
  }
  return batches.get(count);
}

const tasks = {
  rollout() {
    emulator.rollout(start, all);
  },
  gradient() {
    const states = emulator.rollout(start, all.subarray(0, gradientSteps * size));
    let cotangent = new Float32Array(start.length).fill(1);
    for (let t = gradientSteps - 1; t >= 0; t--) {
      const state = states.subarray(t * start.length, (t + 1) * start.length);
      cotangent = emulator.vjp(state, all.subarray(t * size, (t + 1) * size), cotangent).byState;
    }
  },
  batch(count) {
    const batch = roomFor(count);
    for (let t = 0; t < batchSteps; t++) batch.advance();
  },
};

for await (const line of createInterface({ input: process.stdin })) {
  const [task, count] = line.split(" ");
  const began = process.hrtime.bigint();
  tasks[task](Number(count));
  console.log(String(process.hrtime.bigint() - began));
}
"""


def cases(motion: Motion, folder: Path, stack: ExitStack) -> Iterator[Case]:
    """Yield the cases of the module `it.wasm` in `folder`, none without node, which ends with the `stack`."""
    if shutil.which("node") is None:
        return
    facts = {
        "controls": motion.controls.tolist(),
        "size": motion.controls.shape[1],
        "gradientSteps": GRADIENT_STEPS,
        "batchSteps": BATCH_STEPS,
    }
    (folder / "motion.json").write_text(json.dumps(facts))
    (folder / "package.json").write_text('{"type": "module"}')
    (folder / "run.mjs").write_text(SCRIPT)
    pipe = subprocess.PIPE
    command = ["node", "run.mjs"]
    process = subprocess.Popen(command, cwd=folder, stdin=pipe, stdout=pipe, text=True)
    node = stack.enter_context(process)
    yield Case(NAME, SUPER_STEP, STEPS, partial(seconds_of, node, "rollout 1"))
    # The chain rule is the caller's: one step's gradient after the other.
    yield Case(NAME, GRADIENT, GRADIENT_STEPS, partial(seconds_of, node, "gradient 1"))
    for batch in BATCHES:
        run = partial(seconds_of, node, f"batch {batch}")
        yield Case(NAME, batch_task(batch), batch * BATCH_STEPS, run)


def seconds_of(node: subprocess.Popen[str], line: str) -> float:
    """Return how long node took for the task that `line` names [s]."""
    assert node.stdin is not None
    assert node.stdout is not None
    node.stdin.write(f"{line}\n")
    node.stdin.flush()
    said = node.stdout.readline()
    if not said:
        raise ResourceError("runtimes: node ended before its time.")
    return int(said) * 1e-9
