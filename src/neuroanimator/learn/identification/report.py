"""The report of an identification as one page: the recordings, the motions that explain them, and the residuals."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from neuroanimator.learn.evaluation.page import write_page
from neuroanimator.learn.evaluation.plots import EMULATOR, PHYSICS, QUIET
from neuroanimator.learn.identification.identify import Estimate, Identification
from neuroanimator.terminal import TableRows

MAX_SHOWN = 12
"""Maximum number of measured numbers drawn in a report."""

MAX_WINDOWS_SHOWN = 24
"""Maximum number of windows drawn for each."""


def write_identification_report(
    path: Path, result: Identification, rows: Sequence[tuple[str, object]]
) -> None:
    """Write the report to `path`: facts in `rows`, the estimates, and curves of measured and explained motions."""
    measurements = result.measurements
    curves = [
        MeasuredCurve(name, entry, result)
        for name, entry in zip(measurements.names, measurements.entries, strict=True)
    ]
    write_page(
        path,
        "identification.html",
        rows=rows,
        estimates=[estimate_row(estimate) for estimate in result.estimates],
        notes=result.notes,
        fits=fit_rows(result),
        curves=curves[:MAX_SHOWN],
        draw_motion=draw_motion,
        draw_residuals=draw_residuals,
    )


def estimate_row(estimate: Estimate) -> dict[str, object]:
    """Return an estimate as a row of a table."""
    return {
        "parameter": estimate.name,
        "value": f"{estimate.value:.4g}",
        "±": f"{estimate.deviation:.2g}" if estimate.is_known else "unknown",
        "unit": estimate.unit,
        "nominal": f"{estimate.nominal:.4g}",
        "range": f"{estimate.low:.4g} to {estimate.high:.4g}",
    }


def fit_rows(result: Identification) -> TableRows:
    """Return the root mean square residuals of each fit, a row for each number."""
    rows: TableRows = []
    for name, entry in zip(result.measurements.names, result.measurements.entries, strict=True):
        row: dict[str, object] = {"measured": name}
        row["nominal"] = _off(result.nominal.residuals[..., entry])
        row["emulator"] = _off(result.emulated.residuals[..., entry])
        if result.proven is not None:
            row["physics"] = _off(result.proven.residuals[..., entry])
        rows.append(row)
    return rows


def _off(residuals: np.ndarray) -> str:
    return f"{np.sqrt(np.nanmean(np.square(residuals))):.3g}"


class MeasuredCurve:
    """One measured number of an identification to draw."""

    def __init__(self, name: str, entry: int, result: Identification):
        shown = slice(MAX_WINDOWS_SHOWN)
        self.name = name
        self.measured = result.measurements.measured[shown, :, entry]
        self.nominal = self.measured - result.nominal.residuals[shown, :, entry]
        self.found = self.measured - result.final.residuals[shown, :, entry]
        self.is_physics = result.proven is not None

    @property
    def frames(self) -> np.ndarray:
        """Time of every frame of each window, in super steps from the first window's start."""
        windows, frames = self.measured.shape
        firsts = (frames - 1) * np.arange(windows)
        return firsts[:, None] + np.arange(frames)


def draw_motion(axes: Axes, curve: MeasuredCurve) -> None:
    """Draw measurements as points, and windows of motion with nominal and with identified parameters as lines."""
    colour = PHYSICS if curve.is_physics else EMULATOR
    for number, frames in enumerate(curve.frames):
        is_first = number == 0
        axes.plot(
            frames, curve.nominal[number], color=QUIET, lw=1, label="nominal" if is_first else None
        )
        axes.plot(
            frames,
            curve.found[number],
            color=colour,
            lw=1.5,
            label="identified" if is_first else None,
        )
        axes.plot(
            frames, curve.measured[number], "k.", ms=2, label="measured" if is_first else None
        )
    axes.set(xlabel="super step", ylabel=curve.name)
    axes.legend()


def draw_residuals(axes: Axes, curve: MeasuredCurve) -> None:
    """Draw the residuals of the identified motion."""
    colour = PHYSICS if curve.is_physics else EMULATOR
    for frames, measured, found in zip(curve.frames, curve.measured, curve.found, strict=True):
        axes.plot(frames, measured - found, color=colour, lw=1)
    axes.axhline(0, color=QUIET, lw=0.5)
    axes.set(xlabel="super step", ylabel=f"residual of {curve.name}")
