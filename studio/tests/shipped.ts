// Files of the bundles that ship, for tests in Node.

import { readFile } from "node:fs/promises";
import type { Bundle } from "../src/bundle/bundle";
import { sizeOf } from "../src/bundle/layout";
import { Emulator } from "../src/emulator/emulator";
import { Player } from "../src/motion/player";
import { SliderPilot } from "../src/steering/pilots";

const BUNDLES = new URL("../neuroanimator_studio/bundles/", import.meta.url);

/** Return the bytes of a shipped file, such as fish-50/bundle.json. */
export async function shippedFile(path: string): Promise<Uint8Array<ArrayBuffer>> {
  const bytes = await readFile(new URL(path, BUNDLES));
  return new Uint8Array(bytes);
}

/** Return the pendulum, steered by its sliders. */
export async function pendulum(): Promise<{ player: Player; facts: Bundle; emulator: Emulator }> {
  const text = new TextDecoder().decode(await shippedFile("pendulum-50/bundle.json"));
  const facts = JSON.parse(text) as Bundle;
  const module = await WebAssembly.compile(await shippedFile("pendulum-50/emulator.wasm"));
  const sizes = { state: sizeOf(facts.state), control: sizeOf(facts.control), latent: facts.latent };
  const emulator = await Emulator.start(module, sizes);
  const player = new Player(emulator, facts);
  player.pilot = new SliderPilot(facts);
  return { player, facts, emulator };
}
