// Sliders: the controls of muscles, motors or jets, number by number; or the commands of a swimmer.

import { isPhysics } from "../bundle/bundle";
import { labelsOf } from "../bundle/layout";
import type { Pilot } from "../motion/player";
import { button, element, panel, slider, type Slider } from "../page/dom";
import type { Session } from "../page/session";
import type { Life } from "../steering/life";
import type { Intention } from "../steering/mind";
import { neutralControl } from "../steering/pilots";

/** Maximum turn and climb in a command [rad]. */
const MAX_TURN = 1;
const MAX_CLIMB = 0.8;

/** Sizes of schools to choose from: of bones, and of thousands of nodes. */
const SCHOOLS = [0, 20, 200, 1000] as const;
const FLESH_SCHOOLS = [0, 20, 100] as const;

/** Number of others who walk around. */
const WALKERS = 10;

export interface Panel {
  readonly element: HTMLElement;
  update(): void;
}

/** Return a function that makes a slider of `set`; moving it makes `pilot` take over. */
function taking(session: Session, pilot: Pilot, goLive: () => void) {
  return (set: (value: number) => void) => (value: number) => {
    session.player.pilot = pilot;
    set(value);
    goLive();
  };
}

/** Sliders of a swimmer's commands: speed, turn, climb. */
export function steerPanel(session: Session, goLive: () => void, onTarget: () => void): Panel | null {
  const pilot = session.swimmer;
  if (!pilot) {
    return null;
  }
  const { details, body } = panel("Steer", true);
  const { command } = pilot;
  const take = taking(session, pilot, goLive);
  const speed = slider({
    label: "speed",
    unit: "m/s",
    low: 0,
    high: pilot.maxSpeed,
    value: command.speed,
    onInput: take((value) => (command.speed = value)),
  });
  const turn = slider({
    label: "turn left",
    unit: "rad",
    low: -MAX_TURN,
    high: MAX_TURN,
    value: 0,
    onInput: take((value) => (command.turn = value)),
  });
  const climb = slider({
    label: "climb",
    unit: "rad",
    low: -MAX_CLIMB,
    high: MAX_CLIMB,
    value: 0,
    onInput: take((value) => (command.climb = value)),
  });
  const target = button({ label: "Swim to the target", title: "Show a target and swim to it (T)", onClick: onTarget });
  body.append(
    element("p", "", ["Arrow keys steer, Page Up and Page Down climb and dive. Drag the body to push it."]),
    speed.row,
    turn.row,
    climb.row,
    element("div", "row", [target]),
    schoolRow(session),
  );
  const life = session.canLive ? lifeRow(session, goLive) : null;
  if (life) {
    body.append(life.element);
  }
  return {
    element: details,
    update() {
      speed.value = command.speed;
      turn.value = command.turn;
      climb.value = command.climb;
      const hasTarget = pilot.target !== null && session.life === null;
      target.setAttribute("aria-pressed", String(hasTarget));
      life?.update();
    },
  };
}

/** Sliders of a walker's commands: speed and turn rate. */
export function walkPanel(session: Session, goLive: () => void): Panel | null {
  const pilot = session.walker;
  if (!pilot) {
    return null;
  }
  const { details, body } = panel("Steer", true);
  const { command } = pilot;
  const take = taking(session, pilot, goLive);
  const speed = slider({
    label: "speed",
    unit: "m/s",
    ...pilot.speeds,
    value: command.speed,
    onInput: take((value) => (command.speed = value)),
  });
  const turning = slider({
    label: "turn left",
    unit: "rad/s",
    ...pilot.turnings,
    value: command.turning,
    onInput: take((value) => (command.turning = value)),
  });
  const company = button({
    label: `${WALKERS} more, each going its own way`,
    title: "Others who walk around, each going its own way",
    onClick: () => void session.keepWalkers(session.walkers ? 0 : WALKERS),
  });
  body.append(
    element("p", "", ["Arrow keys steer: up and down for faster and slower, left and right to turn."]),
    speed.row,
    turning.row,
    element("div", "row", [company]),
  );
  return {
    element: details,
    update() {
      speed.value = command.speed;
      turning.value = command.turning;
      company.setAttribute("aria-pressed", String(session.walkers !== null));
    },
  };
}

/** Row for the size of the school. */
function schoolRow(session: Session): HTMLElement {
  const select = element("select");
  select.setAttribute("aria-label", "How many swim along");
  for (const count of session.facts.surface ? FLESH_SCHOOLS : SCHOOLS) {
    const option = element("option", "", [count === 0 ? "alone" : `with ${count.toLocaleString("en")} more`]);
    option.value = String(count);
    select.append(option);
  }
  select.addEventListener("change", () => void session.keepSchool(Number(select.value)));
  return element("label", "row", [element("span", "", ["School"]), select]);
}

/** A switch for small fish that live around this one, their shark, and counts of what has happened to them. */
function lifeRow(session: Session, goLive: () => void): Panel {
  const said = element("p", "", [""]);
  const onClick = (): void => {
    if (session.life) {
      void session.keepSchool(0);
      session.swimmer!.target = null;
      session.world.home();
    } else {
      void session.keepLife();
      goLive();
    }
  };
  const live = button({ label: "Be the shark", title: "Fifty small fish that see, get hungry and flee; you are the shark", onClick });
  return {
    element: element("div", "", [element("div", "row", [live]), said]),
    update() {
      const { life } = session;
      live.setAttribute("aria-pressed", String(life !== null));
      const line = life
        ? `${count(life, "wander")} stroll, ${count(life, "school")} school, ${count(life, "eat")} feed, ${count(life, "escape")} flee; ` +
          `${life.eaten} morsels eaten, ${life.caught} fish caught. Click the water to drop food; arrow keys steer the shark.`
        : "";
      if (said.textContent !== line) {
        said.textContent = line;
      }
    },
  };
}

function count(life: Life, intention: Intention): number {
  return life.minds.filter((mind) => mind.intention === intention).length;
}

/** Sliders of the controls themselves. */
export function controlPanel(session: Session, goLive: () => void): Panel {
  const { facts, sliders: pilot, player } = session;
  const { details, body } = panel("Controls", player.pilot === pilot);
  const labels = labelsOf(facts.control);
  const units = facts.control_units ?? facts.control.flatMap(([, size, unit]) => new Array<string>(size).fill(unit));
  const rows: Slider[] = labels.map((label, i) =>
    slider({
      label: label.replaceAll("_", " "),
      unit: units[i]!,
      low: facts.control_low[i]!,
      high: facts.control_high[i]!,
      value: pilot.values[i]!,
      // Without a unit they are shares of the most there is.
      ...(units[i] === "1" ? { full: Math.max(Math.abs(facts.control_low[i]!), Math.abs(facts.control_high[i]!)) } : {}),
      onInput(value) {
        takeOver();
        pilot.values[i] = value;
        goLive();
      },
    }),
  );
  const takeOver = (): void => {
    if (player.pilot !== pilot) {
      pilot.values.splice(0, pilot.values.length, ...neutralControl(facts));
      player.pilot = pilot;
    }
  };
  const neutral = button({
    label: "Let go",
    title: "All controls to none",
    onClick() {
      player.pilot = pilot;
      pilot.values.splice(0, pilot.values.length, ...neutralControl(facts));
      goLive();
    },
  });
  body.append(
    element("p", "", [`Move a slider and the ${isPhysics(facts) ? "physics" : "emulator"} continues live from the playhead.`]),
    ...rows.map((row) => row.row),
    element("div", "row", [neutral]),
  );
  return {
    element: details,
    update() {
      if (!details.open || player.motion.steps === 0) {
        return;
      }
      const isSteering = player.isLive && player.pilot === pilot;
      const shown = isSteering ? pilot.values : player.motion.control(player.step);
      rows.forEach((row, i) => (row.value = shown[i]!));
    },
  };
}
