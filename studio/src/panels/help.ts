// Help on `?`: all keys and mouse actions.

import { button, element } from "../page/dom";

const KEYS: readonly (readonly [keys: string, does: string])[] = [
  ["Space", "play or pause"],
  [",  .", "one super step back, forward"],
  ["Home  End", "to the start, to the end"],
  ["[  ]", "slower, faster"],
  ["L", "live: the emulator continues from the playhead"],
  ["R", "live from the start"],
  ["↑ ↓ ← →", "steer a swimmer or a human: faster, slower, left, right; what moves a cloth: away, nearer, left, right; other systems: the first two controls"],
  ["Page Up  Page Down", "steer a swimmer: climb, dive; what moves a cloth: up, down"],
  ["G", "physics beside the emulator, as a ghost"],
  ["T", "target: swim to it, drag it"],
  ["C", "camera: follow, chase, stay"],
  ["H", "camera: reset"],
  ["Shift + arrows", "turn the camera"],
  ["+  −", "nearer, further"],
  ["Ctrl + Z", "undo: back to the motion shown before"],
  ["1 … 9", "choose a system"],
  ["?", "this help"],
];

const MOUSE: readonly (readonly [keys: string, does: string])[] = [
  ["Drag the background", "turn the camera; with the right button move it; wheel: nearer, further"],
  ["Drag the body", "push it: a human falls and gets up"],
  ["Drag what moves a cloth", "lead it, up to its maximum speed; Shift keeps its height, the wheel moves it nearer or away"],
  ["Drag the target", "move it"],
  ["Click the water", "where small fish live around a shark: drop food"],
  ["Sticks on a touch screen", "what the arrow keys, Page Up and Page Down do"],
  ["Drop a file", "an emulator of your own, where there is a server"],
];

export function makeHelp(): HTMLDialogElement {
  const close = button({ label: "×", title: "Close the help", className: "close", onClick: () => dialog.close() });
  const dialog = element("dialog", "help", [
    close,
    element("h2", "", ["Help"]),
    element("p", "", [
      "A small neural network, the emulator, moves the body: it leaps many physics steps at a time. " +
        "It runs here, in this page. Where the body glows orange, training has not covered what happens: do not trust it there.",
    ]),
    table(KEYS),
    table(MOUSE),
  ]);
  dialog.setAttribute("aria-label", "Help");
  return dialog;
}

function table(rows: readonly (readonly [string, string])[]): HTMLTableElement {
  const body = element(
    "tbody",
    "",
    rows.map(([keys, does]) => element("tr", "", [element("th", "", [keys]), element("td", "", [does])])),
  );
  return element("table", "", [body]);
}
