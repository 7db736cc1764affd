// The movers of a soft body: dragged, led by keys, or left to wander; and the number of bodies.

import { button, element, panel } from "../page/dom";
import type { Session } from "../page/session";
import type { Panel } from "./controls";

/** Sizes of crowds to choose from. */
const CROWDS = [0, 20, 100] as const;

/** Return the panel of a soft body; null for another one. */
export function moverPanel(session: Session, goLive: () => void): Panel | null {
  const { movers, player } = session;
  if (!movers) {
    return null;
  }
  const { details, body } = panel("Steer", true);
  const names = session.facts.movers!.map(([name]) => name).join(", ");
  const wander = button({
    label: "Wander",
    title: "Let everything move by itself",
    onClick() {
      player.pilot = movers.pilot;
      movers.pilot.wander();
      goLive();
    },
  });
  body.append(
    element("p", "", [`Drag what moves it (${names}); Shift keeps it at its height, the wheel moves it nearer or away. Arrow keys, Page Up and Page Down move the one held last.`]),
    element("div", "row", [wander]),
    crowdRow(session),
  );
  return {
    element: details,
    update() {
      const isWandering = player.pilot === movers.pilot && movers.pilot.isWandering;
      wander.setAttribute("aria-pressed", String(isWandering));
    },
  };
}

/** Row for the number of bodies beside it. */
function crowdRow(session: Session): HTMLElement {
  const select = element("select");
  select.setAttribute("aria-label", "How many more of them");
  for (const count of CROWDS) {
    const option = element("option", "", [count === 0 ? "alone" : `with ${count} more`]);
    option.value = String(count);
    select.append(option);
  }
  select.addEventListener("change", () => void session.keepCrowd(Number(select.value)));
  return element("label", "row", [element("span", "", ["Crowd"]), select]);
}
