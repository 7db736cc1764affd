// Sliders of the parameters of a family of bodies: drag the length of a fish while it swims.

import { element, panel, slider } from "../page/dom";
import type { Session } from "../page/session";
import { reshape } from "../steering/reshape";
import type { Panel } from "./controls";

const BODY = "Change the body while it moves. The physics ghost changes with it.";
const WIND = "Change the wind while the body moves. The physics ghost feels it, too.";

/** Return the panel of a family; null for a single body. */
export function parameterPanel(session: Session, goLive: () => void): Panel | null {
  const { facts, player } = session;
  const parameters = facts.parameters ?? [];
  if (parameters.length === 0) {
    return null;
  }
  // The only parameter of a soft body is the wind.
  const isWind = facts.surface !== null && facts.surface !== undefined;
  const { details, body } = panel(isWind ? "Wind" : "Body", true);
  const rows = parameters.map((parameter) =>
    slider({
      label: parameter.name.replaceAll("_", " "),
      unit: parameter.unit === "1" ? "×" : parameter.unit,
      low: parameter.low,
      high: parameter.high,
      value: facts.rest[parameter.entry]!,
      onInput(value) {
        goLive();
        const { motion } = player;
        motion.pushLast(reshape(facts, motion.state(motion.steps), parameter, value));
        session.crowd?.keep(parameter.entry, value);
      },
    }),
  );
  body.append(
    element("p", "", [isWind ? WIND : BODY]),
    ...rows.map((row) => row.row),
  );
  return {
    element: details,
    update() {
      const { motion } = player;
      const state = player.isLive ? motion.state(motion.steps) : player.state();
      rows.forEach((row, i) => (row.value = state[parameters[i]!.entry]!));
    },
  };
}
