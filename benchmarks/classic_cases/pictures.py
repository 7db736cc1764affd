"""The pictures of docs/classic.md, drawn from the tables that the benchmark wrote."""

from __future__ import annotations

import io
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from PIL import Image

from classic_cases.page import NETWORKS, read_rows
from classic_cases.super_steps import CLASSIC, PHYSICS, SHIPS
from classic_cases.surfaces import METHODS
from neuroanimator.files.atomic import write_whole

Rows = list[dict[str, Any]]

WIDTH = 8.4
"""Width of a picture [in]."""

HEIGHT = 3.4
"""Height of a picture [in]."""

DPI = 100
"""Pixels an inch."""

COLOURS = 192
"""Number of colours of a picture."""

BLUE = "#2b5a94"
ORANGE = "#e8892b"
TEAL = "#4fa3a0"
PURPLE = "#7a4f9a"
GREY = "#8a94a0"
OLIVE = "#8a8d2f"

BY_SUBSTEPS = {25: (BLUE, "o"), 50: (TEAL, "s"), 100: (ORANGE, "^"), 200: (PURPLE, "D")}
"""Colour and marker of each number of physics steps: told apart without colours, too."""

APART = 0.18
"""Distance of markers side by side."""

ROUND_TICKS = np.array([2, 5, 10, 20, 50, 100, 300, 1_000, 3_000, 10_000])
"""Values of J that are labelled."""

MAP = "cividis"
"""Colours of surfaces: told apart by those who do not see red or green."""


def save(figure: Figure, path: Path) -> None:
    """Write a picture as PNG."""
    drawn = io.BytesIO()
    figure.savefig(drawn, format="png", dpi=DPI)
    # Few colours take half the bytes; without dithering plain areas stay plain.
    image = Image.open(drawn).convert("RGB")
    few = image.quantize(COLOURS, dither=Image.Dither.NONE)
    picture = io.BytesIO()
    few.save(picture, format="png", optimize=True)
    write_whole(path, picture.getvalue())


def draw_units(path: Path) -> None:
    """Draw errors over the number of hidden units."""
    figure = Figure(figsize=(WIDTH, HEIGHT), layout="constrained")
    pendulum, dolphin = figure.subplots(1, 2, sharey=True)
    styles = {
        "plain": (BLUE, "o", "numbers as they are"),
        "features": (ORANGE, "s", "sines, cosines and mirror"),
    }
    for axes, name in ((pendulum, "pendulum"), (dolphin, "dolphin")):
        rows = read_rows(f"units_{name}")
        for inputs, (colour, marker, label) in styles.items():
            chosen = [row for row in rows if row["inputs"] == inputs]
            if not chosen:
                continue
            units = [row["units"] for row in chosen]
            least = [row["one_step_least"] for row in chosen]
            largest = [row["one_step_largest"] for row in chosen]
            errors = [row["one_step_error"] for row in chosen]
            axes.fill_between(units, least, largest, color=colour, alpha=0.25, linewidth=0)
            axes.loglog(units, errors, color=colour, marker=marker, label=label)
        (shipped,) = (row for row in rows if row["inputs"] == "ships")
        axes.axhline(
            shipped["one_step_error"], color="black", linestyle="--", label="the one that ships"
        )
        axes.axvspan(20, 50, color=GREY, alpha=0.2, linewidth=0, label="the seminar's 20 to 50")
        axes.set_title(name)
        axes.set_xlabel("hidden units")
        ticks = [row["units"] for row in rows if row["inputs"] == "plain"]
        axes.set_xticks(ticks, [f"{tick:.0f}" for tick in ticks], minor=False)
        axes.set_xticks([], minor=True)
        axes.grid(which="both", alpha=0.2)
    ticks = [0.03, 0.1, 0.3, 1]
    pendulum.set_yticks(ticks, [f"{tick:g}" for tick in ticks])
    pendulum.set_ylabel("one-step error\n[standard deviations of the change]")
    pendulum.legend(fontsize="small", loc="lower left", bbox_to_anchor=(0.0, 0.12))
    save(figure, path)


def draw_super_steps(path: Path) -> None:
    """Draw errors of each system after the same time, by how many super steps it is made in."""
    rows = read_rows("super_steps")
    kinds = list(dict.fromkeys((row["system"], row["network"]) for row in rows))
    kinds = [kind for kind in kinds if kind[1] != PHYSICS]
    figure = Figure(figsize=(WIDTH, HEIGHT), layout="constrained")
    soon, late = figure.subplots(1, 2, sharey=True)
    for axes, column, title in (
        (soon, "error_horizon", "after 100 physics steps"),
        (late, "error_5s", "after 5 s"),
    ):
        for number, substeps in enumerate((25, 50, 100)):
            colour, marker = BY_SUBSTEPS[substeps]
            errors = []
            for kind in kinds:
                (row,) = (
                    row
                    for row in rows
                    if (row["system"], row["network"]) == kind and row["substeps"] == substeps
                )
                errors.append(row[column])
            places = np.arange(len(kinds)) + APART * (number - 1)
            axes.semilogy(places, errors, marker, color=colour, label=f"n = {substeps}")
        names = [f"{name}\n{'1998' if network == CLASSIC else ''}" for name, network in kinds]
        axes.set_xticks(
            range(len(kinds)), [name.replace("-", "-\n") for name in names], fontsize="small"
        )
        axes.set_title(title)
        axes.grid(axis="y", which="both", alpha=0.2)
    soon.legend(fontsize="small")
    soon.set_ylabel("error\n[standard deviations of the\nchange in 100 physics steps]")
    save(figure, path)


def draw_spectra(path: Path) -> None:
    """Draw power densities of the joints' velocities, emulated and true."""
    rows = read_rows("spectra")
    figure = Figure(figsize=(WIDTH, HEIGHT + 0.2), layout="constrained")
    for axes, network in zip(figure.subplots(1, 2, sharey=True), (SHIPS, CLASSIC), strict=True):
        of_network = [row for row in rows if row["network"] == network]
        first = [row for row in of_network if row["substeps"] == 25]
        axes.loglog(
            _middles(first),
            _densities(first, "physics"),
            color="black",
            linewidth=2.5,
            label="physics",
        )
        for substeps, (colour, marker) in BY_SUBSTEPS.items():
            chosen = [row for row in of_network if row["substeps"] == substeps]
            axes.loglog(
                _middles(chosen),
                _densities(chosen, "emulated_interpolated"),
                color=colour,
                marker=marker,
                markersize=4,
                linewidth=1,
                label=f"n = {substeps}",
            )
            axes.axvline(500 / substeps, color=colour, linestyle=":", linewidth=1)
        name = "the package's network" if network == SHIPS else NETWORKS[CLASSIC]
        axes.set_title(name if network == SHIPS else f"network {name}")
        axes.set_xlabel("frequency [Hz]")
        ticks = [0.25, 0.5, 1, 2, 4, 8, 16, 32]
        axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
        axes.set_xticks([], minor=True)
        axes.grid(alpha=0.2)
    figure.axes[0].set_ylabel("power density of joint velocities\n[(rad/s)²/Hz]")
    figure.axes[0].legend(fontsize="small", loc="lower left")
    save(figure, path)


def _middles(rows: Rows) -> list[float]:
    return [float(np.sqrt(row["low_hz"] * row["high_hz"])) for row in rows]


def _densities(rows: Rows, column: str) -> list[float]:
    return [row[column] / (row["high_hz"] - row["low_hz"]) for row in rows]


def _surface(axes: Axes, rows: Rows, first: str, second: str, height: str, levels: int = 14) -> Any:
    """Draw a surface as filled contours, its heights on a logarithmic scale."""
    x = np.array(sorted({row[first] for row in rows}))
    y = np.array(sorted({row[second] for row in rows}))
    heights = np.array([row[height] for row in rows]).reshape(len(x), len(y)).T
    steps = np.geomspace(heights.min(), heights.max(), levels)
    norm = LogNorm(heights.min(), heights.max())
    filled = axes.contourf(x, y, heights, steps, cmap=MAP, norm=norm)
    axes.contour(x, y, heights, steps, colors="white", linewidths=0.4)
    return filled


def draw_weights(path: Path) -> None:
    """Draw the training error over two weights."""
    rows = read_rows("weights")
    figure = Figure(figsize=(5.2, 3.9), layout="constrained")
    axes = figure.add_subplot()
    filled = _surface(axes, rows, "weight_1", "weight_2", "error")
    (trained,) = (row for row in rows if row["from_trained_1"] == 0 and row["from_trained_2"] == 0)
    axes.plot(
        trained["weight_1"], trained["weight_2"], "w*", markersize=13, markeredgecolor="black"
    )
    axes.set_xlabel("first weight of a hidden unit")
    axes.set_ylabel("second weight of the same unit")
    bar = figure.colorbar(
        filled, ax=axes, label="training error\n[standard deviations of the change]"
    )
    _plain_ticks(bar, [row["error"] for row in rows])
    save(figure, path)


def _plain_ticks(bar: Any, heights: list[float]) -> None:
    """Label a colour bar with a few plain numbers."""
    ticks = np.geomspace(min(heights), max(heights), 6)
    bar.set_ticks(
        ticks, labels=[f"{tick:,.3g}" if tick < 1000 else f"{tick:,.0f}" for tick in ticks]
    )
    bar.minorticks_off()


def draw_torques(path: Path) -> None:
    """Draw J over two torques with the paths of descents, the method of 1998 beside today's."""
    rows = read_rows("torques")
    descents = read_rows("descents")
    figure = Figure(figsize=(WIDTH, 4.0), layout="constrained")
    panels = figure.subplots(1, 2, sharey=True)
    filled: Any = None
    for axes, method in zip(panels, METHODS, strict=True):
        filled = _surface(axes, rows, "torque_1", "torque_2", "j_emulator")
        of_method = [row for row in descents if row["method"] == method]
        for start in sorted({row["start"] for row in of_method}):
            path_rows = [row for row in of_method if row["start"] == start]
            first = [row["torque_1"] for row in path_rows]
            second = [row["torque_2"] for row in path_rows]
            axes.plot(first, second, color=ORANGE, linewidth=1.1)
            axes.plot(first[0], second[0], "o", color=ORANGE, markersize=3)
            axes.plot(first[-1], second[-1], "w*", markersize=8, markeredgecolor="black")
        name = "with momentum, as in 1998" if method == METHODS[0] else "Gauss-Newton"
        axes.set_title(name)
        axes.set_xlabel("shoulder's torque, first half [N·m]")
    panels[0].set_ylabel("shoulder's torque, second half [N·m]")
    bar = figure.colorbar(filled, ax=panels, label="J on the emulator")
    _plain_ticks(bar, [row["j_emulator"] for row in rows])
    save(figure, path)


LEARNING_STYLES = {
    "batch, as printed": (GREY, "x", ":"),
    "batch": (BLUE, "o", ":"),
    "batch, momentum": (BLUE, "o", "-"),
    "on-line": (ORANGE, "s", ":"),
    "on-line, momentum": (ORANGE, "s", "-"),
    "mini-batch, momentum": (TEAL, "^", "-"),
    "mini-batch, Adam": (PURPLE, "D", "-"),
    "mini-batch, Muon": ("black", "v", "-"),
}
"""Colour, marker and line of each way to learn."""


def draw_learning(path: Path) -> None:
    """Draw errors over the number of examples seen."""
    rows = read_rows("learning")
    figure = Figure(figsize=(WIDTH, HEIGHT + 0.3), layout="constrained")
    axes = figure.add_subplot()
    for way, (colour, marker, line) in LEARNING_STYLES.items():
        chosen = [row for row in rows if row["way"] == way]
        seen = [row["examples_seen"] for row in chosen]
        errors = [row["one_step_error"] for row in chosen]
        axes.loglog(seen, errors, color=colour, marker=marker, linestyle=line, label=way)
    axes.set_xlabel("examples seen, with repetition")
    axes.set_ylabel("one-step error\n[standard deviations of the change]")
    ticks = [0.1, 0.2, 0.5, 1]
    axes.set_yticks(ticks, [f"{tick:g}" for tick in ticks])
    axes.set_yticks([], minor=True)
    axes.set_ylim(0.13, 2)
    axes.grid(which="both", alpha=0.2)
    axes.legend(fontsize="small", loc="center left", bbox_to_anchor=(1.0, 0.5))
    save(figure, path)


def draw_race(path: Path) -> None:
    """Draw J that each way to find controls came to, at equal time, at equal physics steps and at last."""
    rows = read_rows("race")
    tasks = list(dict.fromkeys(row["task"] for row in rows))
    figure = Figure(figsize=(WIDTH, HEIGHT), layout="constrained")
    panels = figure.subplots(1, len(tasks))
    moments = (
        ("j_equal_steps", "as many physics steps", BLUE, "o"),
        ("j_equal_time", "the emulator's time", TEAL, "s"),
        ("j_at_last", "12 times its time, 0.5 s at least", ORANGE, "^"),
    )
    for axes, task in zip(panels, tasks, strict=True):
        chosen = [row for row in rows if row["task"] == task]
        names = [row["method"] for row in chosen]
        for column, label, colour, marker in moments:
            costs = [row[column] for row in chosen]
            axes.semilogy(range(len(names)), costs, marker, color=colour, label=label)
        axes.set_xticks(range(len(names)), names, rotation=30, fontsize="small")
        ticks = ROUND_TICKS[chosen[0]["j_at_last"] / 2 < ROUND_TICKS]
        ticks = ticks[ticks < 2 * max(row["j_equal_steps"] for row in chosen)]
        axes.set_yticks(ticks, [f"{tick:,.0f}" for tick in ticks])
        axes.set_yticks([], minor=True)
        axes.set_title(task)
        axes.grid(axis="y", which="both", alpha=0.2)
    panels[0].set_ylabel("J on the true physics")
    panels[0].legend(fontsize="small", title="J after", title_fontsize="small")
    save(figure, path)


def draw_sensitivity(path: Path) -> None:
    """Draw the shoulder's sensitivity over configurations, true and learnt, and all sensitivities beside what is known."""
    rows = read_rows("sensitivity_maps")
    shipped = [row for row in rows if row["network"] == SHIPS]
    classic = [row for row in rows if row["network"] == CLASSIC]
    figure = Figure(figsize=(WIDTH, 5.6), layout="constrained")
    parts = figure.subfigures(2, 1, height_ratios=(1, 1.1), squeeze=False)
    above, below = parts[:, 0]
    maps = (
        ("true physics", _entry(shipped, "physics_00")),
        ("learnt, package", _entry(shipped, "learnt_00")),
        ("learnt, 1998", _entry(classic, "learnt_00")),
    )
    least = min(float(values.min()) for _, values in maps)
    largest = max(float(values.max()) for _, values in maps)
    panels = above.subplots(1, 3, sharey=True)
    image: Any = None
    for axes, (title, values) in zip(panels, maps, strict=True):
        image = axes.imshow(
            values.T,
            origin="lower",
            extent=(-180, 180, -180, 180),
            cmap=MAP,
            vmin=least,
            vmax=largest,
        )
        axes.set_title(title, fontsize="medium")
        axes.set_xlabel("elbow [°]")
        axes.set_xticks([-180, 0, 180])
        axes.set_yticks([-180, 0, 180])
    panels[0].set_ylabel("wrist [°]")
    above.colorbar(image, ax=panels, label="shoulder's velocity by\nits torque [rad/s per N·m]")
    scatters = below.subplots(1, 2, sharey=True)
    for axes, known, title in (
        (scatters[0], "physics", "true physics over one super step"),
        (scatters[1], "mass", "M⁻¹ Δt"),
    ):
        for chosen, colour, marker, label in (
            (classic, ORANGE, "x", "1998"),
            (shipped, BLUE, ".", "package"),
        ):
            values = _entries(chosen, "learnt")
            axes.plot(
                _entries(chosen, known),
                values,
                marker,
                markersize=3,
                color=colour,
                label=label,
                alpha=0.5,
            )
        limits = [float(_entries(shipped, known).min()), float(_entries(shipped, known).max())]
        axes.plot(limits, limits, color="black", linewidth=1)
        axes.set_xlabel(f"{title} [rad/s per N·m]")
        axes.grid(alpha=0.2)
    scatters[0].set_ylabel("learnt [rad/s per N·m]")
    scatters[0].legend(fontsize="small", markerscale=2)
    save(figure, path)


def _entry(rows: Rows, column: str) -> Float[np.ndarray, "N N"]:
    """Return an entry of the matrix over the elbow's and the wrist's angle."""
    side = round(len(rows) ** 0.5)
    return np.array([row[column] for row in rows]).reshape(side, side)


def _entries(rows: Rows, name: str) -> Float[np.ndarray, " N"]:
    """Return every entry of the matrices called `name` of all configurations."""
    columns = [column for column in rows[0] if column.startswith(f"{name}_")]
    return np.array([[row[column] for column in columns] for row in rows]).ravel()


PICTURES: dict[str, Callable[[Path], None]] = {
    "units": draw_units,
    "super-steps": draw_super_steps,
    "spectra": draw_spectra,
    "weights": draw_weights,
    "torques": draw_torques,
    "learning": draw_learning,
    "race": draw_race,
    "sensitivity": draw_sensitivity,
}
"""What draws each picture."""
