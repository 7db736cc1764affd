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
  const { folder, values } = JSON.parse(line);
  const before = performance.now();
  const module = await opened(folder);
  module.pose(module.facts.start, values);
  let last;
  for (const iteration of descend(module)) last = iteration;
  const milliseconds = performance.now() - before;
  const { iteration, cost, controls } = last;
  console.log(JSON.stringify({ milliseconds, iterations: iteration, cost, controls: Array.from(controls) }));
}
