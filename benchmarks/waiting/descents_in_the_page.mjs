// Descends as the studio's page does, for `descents_in_the_page.py`: a line of JSON in, a line of JSON out.
// node descents_in_the_page.mjs LIBRARY, where the library is the page's own code, built.

import { readFileSync } from "node:fs";
import { createInterface } from "node:readline";
import { pathToFileURL } from "node:url";

const { DescentModule, descend } = await import(pathToFileURL(process.argv[2]));
const modules = new Map();

async function opened(folder) {
  if (!modules.has(folder)) {
    const facts = JSON.parse(readFileSync(`${folder}/bundle.json`, "utf8")).descents[0];
    const compiled = await WebAssembly.compile(readFileSync(`${folder}/${facts.wasm}`));
    modules.set(folder, await DescentModule.start(compiled, facts));
  }
  return modules.get(folder);
}

for await (const line of createInterface({ input: process.stdin })) {
  // `replay` has what physics made of the controls of `z`: the gap to it is to be closed.
  const { folder, values, replay } = JSON.parse(line);
  const before = process.cpuUsage();
  const module = await opened(folder);
  const defects = replay ? module.defectsOf(replay.states, replay.controls) : undefined;
  module.pose(module.facts.start, values, defects);
  let last;
  for (const iteration of descend(module, replay ? [replay.z] : undefined)) last = iteration;
  const { user, system } = process.cpuUsage(before);
  const { iteration, cost, controls, z } = last;
  const answer = { milliseconds: (user + system) / 1000, iterations: iteration, cost, controls: [...controls], z: [...z] };
  console.log(JSON.stringify(answer));
}
