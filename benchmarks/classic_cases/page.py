"""The tables of docs/classic.md, made of the tables that the benchmark wrote: a test holds the page against them."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import numpy as np

from classic_cases.pendulum_1998 import UNITS as USUAL_UNITS
from classic_cases.super_steps import CLASSIC, PHYSICS, SHIPS
from classic_cases.surfaces import AS_GOOD, METHODS, minima
from neuroanimator.evaluation.accuracy import LOST

Rows = list[dict[str, Any]]

RESULTS = Path(__file__).parent.parent / "results"

NETWORKS = {SHIPS: "as it ships", CLASSIC: f"of 1998, {USUAL_UNITS} units"}
"""Names of networks in tables."""


def read_rows(name: str) -> Rows:
    """Return the rows of results/classic_NAME.csv, numbers as numbers."""
    path = RESULTS / f"classic_{name}.csv"
    lines = path.read_text(encoding="utf-8").splitlines()
    table = csv.DictReader(line for line in lines if not line.startswith("#"))
    return [{key: _number(text) for key, text in row.items()} for row in table]


def _number(text: str) -> Any:
    try:
        return float(text)
    except ValueError:
        return text


def figure(value: float) -> str:
    """Return a number with the digits a reader needs."""
    if value >= 100:
        return f"{value:,.0f}"
    if value >= 10:
        return f"{value:.1f}"
    if value >= 1:
        return f"{value:.2f}"
    return f"{value:.3f}"


def markdown(header: list[str], rows: list[list[str]]) -> str:
    """Return a table, all but its first column to the right."""
    lines = [f"| {' | '.join(header)} |", "| --- |" + " ---: |" * (len(header) - 1)]
    lines += [f"| {' | '.join(row)} |" for row in rows]
    return "\n".join(lines)


def tables() -> list[str]:
    """Return every table of the page, in its order."""
    return [
        units_table(),
        super_steps_table(),
        spectra_table(),
        weights_table(),
        torques_table(),
        learning_table(),
        race_table(),
        sensitivity_table(),
    ]


def units_table() -> str:
    """Return errors over the number of hidden units."""
    rows = read_rows("units_pendulum") + read_rows("units_dolphin")
    columns = (("pendulum", "plain"), ("pendulum", "features"), ("dolphin", "plain"))
    cells: dict[tuple[str, str, Any], str] = {}
    for row in rows:
        spread = f"{figure(row['one_step_least'])} to {figure(row['one_step_largest'])}"
        text = f"{figure(row['one_step_error'])} ({spread})"
        if row["inputs"] == "ships":
            text = figure(row["one_step_error"])
        cells[row["system"], row["inputs"], row["units"]] = text
    units = [row["units"] for row in read_rows("units_dolphin") if row["inputs"] == "plain"]
    body = []
    for count in units:
        texts = [cells[system, inputs, count] for system, inputs in columns]
        body.append([f"{count:.0f}", *texts])
    shipped = [
        cells[row["system"], "ships", row["units"]] for row in rows if row["inputs"] == "ships"
    ]
    body.append(["the emulator that ships", "", *shipped])
    header = [
        "hidden units",
        "pendulum, the state as it is",
        "pendulum, with sines, cosines and mirror",
        "dolphin, its shapes as they are",
    ]
    return markdown(header, body)


def super_steps_table() -> str:
    """Return errors of super steps of several lengths after the same time."""
    rows = read_rows("super_steps")
    kinds = list(dict.fromkeys((row["system"], row["network"]) for row in rows))
    body = []
    for system, network in kinds:
        if network == PHYSICS:
            continue
        chosen = [row for row in rows if (row["system"], row["network"]) == (system, network)]
        (physics,) = (row for row in rows if (row["system"], row["network"]) == (system, PHYSICS))
        soon = [figure(row["error_horizon"]) for row in chosen]
        late = [figure(row["error_5s"]) for row in chosen]
        name = f"{system}, {NETWORKS[network]}"
        body.append([name, *soon, *late, figure(physics["error_5s"])])
    header = [
        "after 100 physics steps, and after 5 s",
        "4 of n = 25",
        "2 of n = 50",
        "1 of n = 100",
    ]
    header += ["5 s, n = 25", "n = 50", "n = 100", "physics, n = 1"]
    return markdown(header, body)


def spectra_table() -> str:
    """Return the power of emulated motion over that of true motion, by octave."""
    rows = read_rows("spectra")
    kinds = list(dict.fromkeys((row["network"], row["substeps"]) for row in rows))
    lows = sorted({row["low_hz"] for row in rows})
    octaves = lows[::3]
    body = []
    first = kinds[0]
    powers = {
        row["low_hz"]: row["physics"] for row in rows if (row["network"], row["substeps"]) == first
    }
    chances = {row["low_hz"]: row["chance"] for row in read_rows("spectra_chance")}
    for low in octaves:
        power = sum(powers[band] for band in powers if 0.99 * low < band < 1.9 * low)
        cells = [f"{low:g} to {2 * low:g}", f"{100 * power / sum(powers.values()):.1f}"]
        cells.append(f"± {chances[low]:.2f}")
        for network, substeps in kinds:
            of_kind = [
                row for row in rows if (row["network"], row["substeps"]) == (network, substeps)
            ]
            cells.append(_octave_ratio(of_kind, low))
        body.append(cells)
    header = ["Hz", "of the power [%]", "chance"]
    for network, substeps in kinds:
        name = "1998" if network == CLASSIC else "package"
        header.append(f"{name}, n = {substeps:.0f}")
    return markdown(header, body)


def _octave_ratio(rows: Rows, low: float) -> str:
    """Return the emulated power over the true one at super steps; beyond what these can tell, as drawn, and of the physics."""
    octave = [row for row in rows if 0.99 * low < row["low_hz"] < 1.9 * low]
    is_told = all(row["emulated_at_super_steps"] != "" for row in octave)
    if is_told:
        emulated = sum(row["emulated_at_super_steps"] for row in octave)
        return figure(emulated / sum(row["physics_at_super_steps"] for row in octave))
    physics = sum(row["physics"] for row in octave)
    emulated = sum(row["emulated_interpolated"] for row in octave) / physics
    true = sum(row["physics_interpolated"] for row in octave) / physics
    return f"*{figure(emulated)} ({figure(true)})*"


def weights_table() -> str:
    """Return what the surface of the training error over two weights is like."""
    rows = read_rows("weights")
    (every,) = read_rows("curvatures")
    errors = _grid(rows, "from_trained_1", "from_trained_2", "error")
    middle = len(errors) // 2
    curvature = rows[0]["curvature_largest"] / rows[0]["curvature_least"]
    body = [
        ["trained", figure(errors[middle, middle])],
        ["least on the surface", figure(errors.min())],
        ["largest on the surface", figure(errors.max())],
        ["minima inside it", f"{minima(errors)}"],
        ["of these two weights: largest curvature over the least", figure(curvature)],
        [
            f"of all {every['weights']:,.0f} weights: largest curvature over the median",
            f"{every['largest'] / every['median_size']:,.0f}",
        ],
        ["of these: curvatures above a hundredth of the largest", f"{every['large']:.0f}"],
        ["of these: negative ones", f"{every['negative']:.0f}"],
    ]
    return markdown(["root mean square error of training", ""], body)


def torques_table() -> str:
    """Return what the surface of J over two torques is like, and what descents find there."""
    rows = read_rows("torques")
    emulated = _grid(rows, "torque_1", "torque_2", "j_emulator")
    true = _grid(rows, "torque_1", "torque_2", "j_physics")
    correlation = np.corrcoef(np.log(emulated).ravel(), np.log(true).ravel())[0, 1]
    body = [
        ["least J on the surface: emulator, physics", f"{emulated.min():.0f}, {true.min():.0f}"],
        ["correlation of log J, emulator and physics", f"{correlation:.4f}"],
    ]
    descents = read_rows("descents")
    last = max(row["iteration"] for row in descents)
    for method in METHODS:
        ends = [row for row in descents if row["method"] == method and row["iteration"] == last]
        good = sum(row["j_physics"] <= AS_GOOD * true.min() for row in ends)
        worst = max(row["j_physics"] for row in ends)
        found = f"{good} of {len(ends)}, {worst:.0f}"
        body.append([f"{method}: ended at the lowest minimum; the worst end, J", found])
    return markdown(["J over two torques", ""], body)


def _grid(rows: Rows, first: str, second: str, height: str) -> np.ndarray:
    """Return a column of a grid's rows as an array (N, M)."""
    side = len({row[first] for row in rows})
    assert len(rows) == side * len({row[second] for row in rows})
    return np.array([row[height] for row in rows]).reshape(side, -1)


def learning_table() -> str:
    """Return errors of ways to learn after equal numbers of examples seen."""
    rows = read_rows("learning")
    ways = list(dict.fromkeys(row["way"] for row in rows))
    body = []
    for way in ways:
        of_way = [row for row in rows if row["way"] == way]
        last = of_way[-1]
        (early,) = (row for row in of_way if row["examples_seen"] == last["examples_seen"] / 20)
        spread = f"{figure(last['one_step_least'])} to {figure(last['one_step_largest'])}"
        end = f"{figure(last['one_step_error'])} ({spread})"
        if last["one_step_least"] > LOST:
            end = f"over {figure(LOST)}"
        body.append(
            [
                way,
                f"{last['batch']:,.0f}",
                f"{last['rate']:g}",
                f"{last['updates']:,.0f}",
                figure(early["one_step_error"]),
                end,
            ]
        )
    seen = rows[-1]["examples_seen"]
    header = ["learning", "examples a change", "best η", "changes"]
    header += [f"error after {seen / 20:,.0f} examples", f"after {seen:,.0f}"]
    return markdown(header, body)


def race_table() -> str:
    """Return J that ways to find controls came to."""
    body = []
    for row in read_rows("race"):
        evaluations = f"{row['evaluations']:,.0f}"
        body.append(
            [
                f"{row['task']}, {row['method']}",
                figure(row["j_equal_time"]),
                figure(row["j_equal_steps"]),
                figure(row["j_at_last"]),
                f"{row['reached']:.0f} of {row['trials']:.0f}",
                evaluations,
                f"{row['physics_steps']:,.0f}",
                figure(row["seconds"]),
            ]
        )
    header = ["task", "J after the emulator's time", "after its physics steps", "at last"]
    header += ["reached", "evaluations", "physics steps", "seconds"]
    return markdown(header, body)


def sensitivity_table() -> str:
    """Return how near what was learnt comes to what is known."""
    body = []
    for row in read_rows("sensitivity"):
        cells = [f"{NETWORKS[row['network']]}, n = {row['substeps']:.0f}"]
        for name in ("physics", "mass_damped", "mass"):
            correlation = f"{row[f'correlation_{name}']:.4f}"
            cells.append(f"{correlation}, {figure(row[f'error_{name}'])}")
        cells.append(f"{row['correlation_physics_mass']:.4f}")
        body.append(cells)
    header = [
        "network: correlation and relative error",
        "with the physics' own",
        "with (M + Δt D)⁻¹ Δt",
    ]
    header += ["with M⁻¹ Δt", "the physics' own with M⁻¹ Δt"]
    return markdown(header, body)
