"""Spectra of the joints' velocities in long motions, emulated and true: what large super steps lose."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.signal import welch

import neuroanimator as na
from classic_cases.lessons import rollouts
from classic_cases.pendulum_1998 import UPDATES, classic_networks, pendulum_lesson, taught
from classic_cases.super_steps import CLASSIC, PENDULUM, SHIPS
from neuroanimator.data.sampling import sample_control_runs, sample_starts
from neuroanimator.emulator.emulator import Emulator

Rows = list[dict[str, Any]]

SUBSTEPS = (25, 50, 100, 200)
"""Numbers of physics steps in a super step; 200 does not ship and is trained here."""

LONGEST = 200
"""Number of physics steps for which a control is held, whatever the super step."""

SAMPLE_DT = 0.005
"""Time between two samples of the true motion and of interpolated ones [s]."""

RUNS = 12
"""Number of motions."""

SECONDS = 60.0
"""Length of a motion [s]."""

COPIES = 8
"""Number of times all motions are made again from starts that differ by a trifle."""

TRIFLE = 1e-3
"""Standard deviation of that difference [rad] and [rad/s]."""

SEGMENT = 8.0
"""Length of the pieces that Welch's method averages over [s]."""

LOWEST = 0.25
"""Where the first band begins [Hz]."""

OCTAVES = 7
"""Number of octaves, up to 32 Hz."""

BANDS_AN_OCTAVE = 3
"""Number of bands in an octave."""

VELOCITIES = slice(3, 6)
"""Where the velocities of the joints lie in the state."""

GATED_WIDTHS = (96, 64)
"""Hidden layers of the pendulum's emulators that ship."""


class Motions(NamedTuple):
    """True motions of the pendulum."""

    starts: Float[np.ndarray, "B S"]
    controls: Float[np.ndarray, "B T C"]
    """Each held for `LONGEST` physics steps."""
    velocities: Float[np.ndarray, "B F 3"]
    """Those of the joints, `SAMPLE_DT` apart."""


def true_motions(is_quick: bool) -> Motions:
    """Return random motions of the pendulum under random controls: always the same."""
    system = na.load_system(PENDULUM)
    rng = np.random.default_rng(34)
    dt = LONGEST * system.physics_dt
    runs = 2 if is_quick else RUNS
    steps = round((10.0 if is_quick else SECONDS) / dt)
    starts = sample_starts(system, rng, runs)
    controls = sample_control_runs(rng, runs, steps, dt, system)
    return Motions(starts, controls, true_velocities(starts, controls))


def true_velocities(
    starts: Float[np.ndarray, "B S"], controls: Float[np.ndarray, "B T C"]
) -> Float[np.ndarray, "B F 3"]:
    """Return the velocities of the joints on the true physics, `SAMPLE_DT` apart."""
    system = na.load_system(PENDULUM)
    held = round(LONGEST * system.physics_dt / SAMPLE_DT)
    fine_controls = np.repeat(controls, held, axis=1)
    runs = system.simulate(starts, fine_controls, SAMPLE_DT, scheme=system.truth)
    return runs.states[..., VELOCITIES]


def chance_rows(is_quick: bool) -> Rows:
    """Return a row per octave: how far powers of the physics are from its own, where starts differ by a trifle.

    Motions are chaotic, so that they part; an emulator's powers cannot be told from the true ones by less.
    """
    motions = true_motions(is_quick)
    edges = LOWEST * 2.0 ** np.arange(OCTAVES + 1)
    powers = np.array(band_powers(motions.velocities, SAMPLE_DT, edges))
    rng = np.random.default_rng(35)
    ratios = []
    for _ in range(2 if is_quick else COPIES):
        starts = motions.starts + TRIFLE * rng.normal(size=motions.starts.shape)
        velocities = true_velocities(starts, motions.controls)
        ratios.append(np.array(band_powers(velocities, SAMPLE_DT, edges)) / powers)
    chances = np.sqrt(np.mean((np.array(ratios) - 1) ** 2, axis=0))
    rows = []
    for low, chance in zip(edges[:-1], chances, strict=True):
        rows.append({"low_hz": float(low), "high_hz": float(2 * low), "chance": float(chance)})
    return rows


def spectrum_rows(is_quick: bool) -> Rows:
    """Return a row per network, super step and band: the power of the joints' velocities [(rad/s)²]."""
    motions = true_motions(is_quick)
    rows = []
    for substeps in SUBSTEPS[:1] if is_quick else SUBSTEPS:
        for network, emulator in emulators_of(substeps, is_quick).items():
            controls = np.repeat(motions.controls, LONGEST // substeps, axis=1)
            states = rollouts(emulator, motions.starts, controls)
            velocities = np.asarray(states, float)[..., VELOCITIES]
            rows += rows_of(network, substeps, emulator.dt, motions.velocities, velocities)
    return rows


def emulators_of(substeps: int, is_quick: bool) -> dict[str, Emulator]:
    """Return the emulator with the package's network and one with that of 1998."""
    classic = classic_networks(substeps, is_quick).emulators[0]
    if substeps != LONGEST:
        return {SHIPS: na.load_emulator(f"{PENDULUM}-{substeps}"), CLASSIC: classic}
    lesson = pendulum_lesson(substeps, is_quick)
    settings = na.TrainingConfig(widths=GATED_WIDTHS, updates=UPDATES)
    gated = taught(lesson, lesson.network("gated", GATED_WIDTHS), settings, is_quick, seeds=1)
    return {SHIPS: gated.emulators[0], CLASSIC: classic}


def rows_of(
    network: str,
    substeps: int,
    dt: float,
    truth: Float[np.ndarray, "B F 3"],
    velocities: Float[np.ndarray, "B T 3"],
) -> Rows:
    """Return the rows of one emulator, whose super step is `dt` [s]."""
    every = round(dt / SAMPLE_DT)
    interpolated = interpolate(velocities, every)
    edges = LOWEST * 2.0 ** (np.arange(OCTAVES * BANDS_AN_OCTAVE + 1) / BANDS_AN_OCTAVE)
    whole = band_powers(truth, SAMPLE_DT, edges)
    drawn = band_powers(interpolated, SAMPLE_DT, edges)
    sampled = band_powers(truth[:, ::every], dt, edges)
    emulated = band_powers(velocities, dt, edges)
    drawn_truth = band_powers(interpolate(truth[:, ::every], every), SAMPLE_DT, edges)
    rows = []
    for band in range(len(edges) - 1):
        is_told = edges[band + 1] <= 0.5 / dt
        rows.append(
            {
                "network": network,
                "substeps": substeps,
                "low_hz": float(edges[band]),
                "high_hz": float(edges[band + 1]),
                "physics": whole[band],
                "emulated_interpolated": drawn[band],
                "physics_interpolated": drawn_truth[band],
                "physics_at_super_steps": sampled[band] if is_told else "",
                "emulated_at_super_steps": emulated[band] if is_told else "",
            }
        )
    return rows


def interpolate(velocities: Float[np.ndarray, "B T 3"], every: int) -> Float[np.ndarray, "B F 3"]:
    """Return velocities with `every` samples to a super step, linear between, as the seminar has frames."""
    count = velocities.shape[1]
    moments = np.arange((count - 1) * every + 1) / every
    before = np.minimum(moments.astype(int), count - 2)
    share = (moments - before)[:, None]
    return velocities[:, before] * (1 - share) + velocities[:, before + 1] * share


def band_powers(
    velocities: Float[np.ndarray, "B T 3"], dt: float, edges: Float[np.ndarray, " K"]
) -> list[float]:
    """Return the power between neighbouring `edges` [Hz], the mean over motions, summed over joints [(rad/s)²]."""
    frequencies, density = welch(velocities, fs=1 / dt, nperseg=round(SEGMENT / dt), axis=1)
    total = density.mean(axis=0).sum(axis=1)
    # The integral up to each edge, so that narrow bands need no frequency of their own.
    integral = np.concatenate(
        [[0.0], np.cumsum((total[1:] + total[:-1]) / 2 * np.diff(frequencies))]
    )
    return [float(power) for power in np.diff(np.interp(edges, frequencies, integral))]
