"""Times of the studio's page to find controls, beside Python; writes descents_in_the_page.csv.

python -m benchmarks.waiting.descents_in_the_page          every bundle, random bays or targets
python -m benchmarks.waiting.descents_in_the_page --quick  two targets each; writes no file

The page's own code runs in Node, on the modules that ship. Both descend from the same guesses to the same targets, one
after the other, several times; times are CPU times. The controls of the page are judged on the physics, at the first
replay, and after the page has closed the gap. Needs `make page`.
"""

from __future__ import annotations

import json
import subprocess
import time
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import IO, Any

import numpy as np

from benchmarks.harness import ROOT, keep_rows, parser_of, show_rows
from neuroanimator import load_emulator
from neuroanimator.control.descent.descend import evaluator_of
from neuroanimator.control.descent.methods import METHODS
from neuroanimator.learn.evaluation.held_out import system_of
from neuroanimator.systems.system import System
from neuroanimator_studio.catalogue import shipped_folder
from neuroanimator_studio.descent_module import ITERATIONS, PageDescent
from neuroanimator_studio.descents import WITH_DESCENT, descent_of, judge_motion

STUDIO = ROOT / "studio"

PLACES = 12
"""Places of each bundle; the first one is where the page begins."""

REPEATS = 5
"""Number of repetitions of which the best counts: the machine may have other things to do."""

ROUNDS = 3
"""Maximum number of rounds in which the page may close the gap."""

Row = dict[str, Any]

Values = dict[str, list[float]]
"""Where what may be moved is moved to."""


def build(folder: Path) -> Path:
    """Build the page's descents for Node; return the library."""
    entry = folder / "library.ts"
    synthesis = (STUDIO / "src" / "synthesis").as_posix()
    entry.write_text(
        f'export {{ DescentModule }} from "{synthesis}/module";\nexport {{ descend }} from "{synthesis}/descend";\n'
    )
    command = ["npx", "vite", "build", "--logLevel", "error", "--ssr", str(entry), "--outDir", str(folder / "out")]  # fmt: skip
    subprocess.run(command, cwd=STUDIO, check=True)
    (library,) = (folder / "out").glob("library.*js")
    return library


class Page:
    """The page's descents, in a process of Node."""

    def __init__(self, library: Path):
        script = Path(__file__).with_suffix(".mjs")
        self._process = subprocess.Popen(
            ["node", str(script), str(library)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )

    def descend(self, bundle: str, values: Values, replay: Row | None = None) -> Row:
        """Return what a descent came to, and how long it took; `replay` is that of an earlier one, to learn from."""
        asked, answers = self._pipes()
        folder = str(shipped_folder() / bundle)
        asked.write(json.dumps({"folder": folder, "values": values, "replay": replay}) + "\n")
        asked.flush()
        return json.loads(answers.readline())

    def close(self) -> None:
        """End the process."""
        self._pipes()[0].close()
        self._process.wait()

    def _pipes(self) -> tuple[IO[str], IO[str]]:
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        return self._process.stdin, self._process.stdout


def in_python(descent: PageDescent, values: Values) -> tuple[float, int, float]:
    """Return (time [ms], iterations, J) of the same descent in Python."""
    evaluator = evaluator_of(descent.moved(values))
    method = METHODS["gauss-newton"]
    began = time.process_time()
    starts = [method.begin(guess) for guess in descent.guesses]
    iterations = 0
    while not all(start.is_done for start in starts) and iterations < ITERATIONS:
        going = [start for start in starts if not start.is_done]
        following = iter(method.iterate(evaluator, going))
        starts = [start if start.is_done else next(following) for start in starts]
        iterations += 1
    best = min(starts, key=lambda start: start.least)
    evaluator.motion(best.best)
    return 1e3 * (time.process_time() - began), iterations, best.least


def places_of(descent: PageDescent, system: System, count: int) -> list[Values]:
    """Return the bays of a lot; elsewhere what the page begins with, and random values of what may be moved."""
    if any(one.kind == "heading" for one in descent.movable):
        bays = [dict(goal.values) for goal in system.goals.values()]
        return [
            {"place": [bay[axis] for axis in range(3)], "heading": [2 * np.arctan2(bay[6], bay[3])]}
            for bay in bays[:count]
        ]
    rng = np.random.default_rng(1)
    places: list[Values] = [{}]
    movable = [one for one in descent.movable if one.kind == "place"]
    while movable and len(places) < count:
        places.append({one.name: rng.uniform(one.low, one.high).tolist() for one in movable})
    return places


def rounds_to_success(
    page: Page, bundle: str, descent: PageDescent, values: Values, answer: Row
) -> float:
    """Return after how many rounds of closing the gap the physics does it; infinite for never."""
    emulator = descent.problem.emulator
    system = system_of(emulator)
    start = np.asarray(descent.problem.start, float)
    for number in range(ROUNDS + 1):
        controls = np.reshape(answer["controls"], (-1, emulator.control.size))
        held = emulator.bounds.clip(controls)
        states = system.simulate_fastest(start[None], held[None], emulator.dt).states[0]
        if judge_motion(emulator, system, values, states).is_success:
            return number
        replay = {"states": states.ravel().tolist(), "controls": answer["controls"], "z": answer["z"]}  # fmt: skip
        answer = page.descend(bundle, values, replay)
    return np.inf


def row_of(page: Page, bundle: str, count: int) -> Row:
    """Return a line of the table."""
    emulator = load_emulator(bundle)
    system = system_of(emulator)
    descent = descent_of(emulator, system)
    assert descent is not None
    cold = page.descend(bundle, {})["milliseconds"]
    in_python(descent, {})
    times, iterations, ratios, differences, rounds = [], [], [], [], []
    for values in places_of(descent, system, count):
        tries = [(page.descend(bundle, values), in_python(descent, values)) for _ in range(REPEATS)]
        ours = min(one["milliseconds"] for one, _ in tries)
        theirs = min(other[0] for _, other in tries)
        answer, (_, _, cost) = tries[0]
        times.append(ours)
        ratios.append(ours / theirs)
        iterations.append(answer["iterations"])
        differences.append(answer["cost"] / cost - 1)
        rounds.append(rounds_to_success(page, bundle, descent, values, answer))
    return {
        "bundle": bundle,
        "places": len(times),
        "guesses": len(descent.guesses),
        "numbers": descent.guesses.shape[1],
        "iterations_median": float(np.median(iterations)),
        "iterations_most": max(iterations),
        "first_cpu_ms": cold,
        "median_cpu_ms": float(np.median(times)),
        "longest_cpu_ms": max(times),
        "cpu_ms_an_iteration": float(np.median(np.array(times) / iterations)),
        "times_python": float(np.median(ratios)),
        "j_over_python_median": float(np.median(differences)),
        "success_at_first_replay": float(np.mean(np.array(rounds) == 0)),
        "success_with_gap_closed": float(np.isfinite(rounds).mean()),
    }


def main() -> None:
    """Measure, print, and write the table."""
    options = parser_of(__doc__, quick="two targets each").parse_args()
    is_quick = options.quick
    with TemporaryDirectory() as folder:
        page = Page(build(Path(folder)))
        rows = [row_of(page, bundle, 2 if is_quick else PLACES) for bundle in WITH_DESCENT]
        page.close()
    show_rows(rows)
    keep_rows(Path(__file__).with_suffix(".csv"), rows, options)


if __name__ == "__main__":
    main()
