// What the page says is true where it says it, and of what it shows now.

import { expect, test } from "vitest";
import { nameOf } from "../src/bundle/bundle";
import { PassingNotices } from "../src/page/banner";
import { timeLeft } from "../src/panels/take";
import { sayNoPhysics } from "../src/server/advice";
import type { Live } from "../src/server/live";

test("what is said of a system leaves with it, and nothing is said of it afterwards", () => {
  const shown = new Map<string, string>();
  const notices = new PassingNotices({
    say: (topic, line) => void shown.set(topic, line),
    tell: (line) => void shown.set("passing", line),
    clear: (topic) => void shown.delete(topic),
  });
  shown.set("server", "not of the system");
  notices.say("physics", "No physics ghost: it diverged.");
  expect(shown.size).toBe(2);
  notices.end();
  notices.say("physics", "said too late");
  notices.tell("said too late");
  expect([...shown.keys()]).toEqual(["server"]);
});

test("a page with a server does not advise to start one", () => {
  expect(sayNoPhysics({} as Live)).not.toContain("neuroanimator studio");
  expect(sayNoPhysics(null)).toContain("'neuroanimator studio'");
});

test("a dropped file is called by its system, and one that ships by its name", () => {
  const title = "my-arm, 4 steps at a time";
  expect(nameOf({ id: "0123456789abcdef", title, system: "my-arm" })).toBe(title);
  expect(nameOf({ id: "0123456789abcdef", system: "my-arm" })).toBe("my-arm");
  expect(nameOf({ id: "fish-50", title: "fish, 50 steps at a time", system: "fish" })).toBe("fish-50");
});

test.each([
  [0, 3, ""],
  [0.5, 10, "10 s left"],
  [0.25, 60, "3 min 0 s left"],
  [1, 60, "0 s left"],
])("a film of which %f is done after %i s says '%s'", (done, seconds, words) => {
  expect(timeLeft(done, seconds)).toBe(words);
});
