"""Wrinkles of the soft bodies that ship: energy by spatial frequency, power by frequency in time; physics and emulators."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int
from matplotlib.figure import Figure
from scipy.fft import dctn

import neuroanimator as na
from large_bodies_cases.equal_error import STEPS, Test, controls_of, emulated_states, known_states
from large_bodies_cases.families import FAMILIES, Shape
from neuroanimator.files.atomic import write_whole

Rows = list[dict[str, Any]]

NODES = 60
"""Number of nodes, spread over the numbers of the mesh, whose motion is taken apart by frequency in time."""

SPACE = "space"
TIME = "time"

LOWEST = {SPACE: 1.0, TIME: 0.5}
"""Where the first octave begins: cycles over the body's size, or hertz."""

UNITS = {SPACE: "cycles over the size", TIME: "Hz"}

BINS = 3
"""Number of the figure's bins in an octave."""


class Spectrum(NamedTuple):
    """Energies by frequency, side by side, and of what the emulator has wrong."""

    frequencies: Float[np.ndarray, " M"]
    physics: Float[np.ndarray, " M"]
    shapes: Float[np.ndarray, " M"]
    """Of the physics started from the shapes, told by them."""
    emulator: Float[np.ndarray, " M"]
    error: Float[np.ndarray, " M"]
    """Of the emulator less the physics."""


def spectra_of(test: Test, emulator: na.Emulator) -> dict[str, Spectrum]:
    """Return the spectra of nodes seen from what holds them, less where they rest.

    In space after a second, over the numbers of the mesh's grid; in time over all of the test.
    """
    shapes = test.system.shapes
    known = emulated_states(emulator, test)[:, 1:]
    runs = test.system.simulate(known_states(test), controls_of(test), test.dt)
    from_shapes = runs.states[:, 1:]
    after = min(STEPS, len(test.truth)) - 1
    every = np.arange(len(shapes.mean))
    some = np.linspace(0, every[-1], NODES).round().astype(int)
    shape = FAMILIES[test.system.name].shape
    return {
        SPACE: spectrum_in_space(
            shape,
            grid_frequencies(shapes.mean, shape, test.system.scene.size),
            own_nodes(test, every, slice(after, after + 1))[:, 0],
            shapes.unplaced(from_shapes[:, after]) - shapes.mean,
            shapes.unplaced(known[:, after]) - shapes.mean,
        ),
        TIME: spectrum_in_time(
            test.dt,
            own_nodes(test, some, slice(None)),
            shapes.unplaced(from_shapes, some) - shapes.mean[some],
            shapes.unplaced(known, some) - shapes.mean[some],
        ),
    }


def own_nodes(
    test: Test, nodes: Int[np.ndarray, " n"], steps: slice
) -> Float[np.ndarray, "L T n 3"]:
    """Return how far the physics has moved nodes from where they rest, seen from what holds them [m]."""
    positions = np.moveaxis(test.truth[steps][:, nodes], -1, 0).astype(float)
    movers = np.moveaxis(test.paths[1:][steps], -1, 0)
    mean = test.system.shapes.mean[nodes]
    still = np.zeros_like(movers)
    own = test.system.scene.own_motion(positions, 0 * positions, movers, still, mean)
    return own.positions - mean


def grid_frequencies(
    mean: Float[np.ndarray, "N 3"], shape: Shape, size: float
) -> Float[np.ndarray, " N"]:
    """Return the frequencies of the cosines over a grid of nodes [cycles over the body's size].

    A side is as long as its rows of nodes on average.
    """
    grid = mean.reshape(*shape, 3)
    squares = np.zeros(shape)
    for axis, count in enumerate(shape):
        steps = np.linalg.norm(np.diff(grid, axis=axis), axis=-1)
        length = steps.sum(axis=axis).mean()
        waves = np.arange(count) / 2 * size / length
        along = np.ones(len(shape), int)
        along[axis] = count
        squares += (waves**2).reshape(along)
    return np.sqrt(squares).ravel()


def spectrum_in_space(
    shape: Shape,
    frequencies: Float[np.ndarray, " N"],
    physics: Float[np.ndarray, "L N 3"],
    shapes: Float[np.ndarray, "L N 3"],
    emulator: Float[np.ndarray, "L N 3"],
) -> Spectrum:
    """Return the energies of cosines over the grid, of all runs together [m²]."""

    def energies(nodes: Float[np.ndarray, "L N 3"]) -> Float[np.ndarray, " N"]:
        grid = nodes.reshape(-1, *shape, 3)
        axes = tuple(range(1, 1 + len(shape)))
        waves = np.asarray(dctn(grid, axes=axes, norm="ortho"))
        return (waves**2).sum(axis=(0, -1)).ravel()

    parts = [energies(nodes) for nodes in (physics, shapes, emulator, emulator - physics)]
    return Spectrum(frequencies, *parts)


def spectrum_in_time(
    dt: float,
    physics: Float[np.ndarray, "L T n 3"],
    shapes: Float[np.ndarray, "L T n 3"],
    emulator: Float[np.ndarray, "L T n 3"],
) -> Spectrum:
    """Return the power of nodes' motion, of all of them and all runs together [m²], through Hann's window."""
    count = physics.shape[1]
    window = np.hanning(count)[:, None, None]

    def powers(nodes: Float[np.ndarray, "L T n 3"]) -> Float[np.ndarray, " M"]:
        moving = nodes - nodes.mean(axis=1, keepdims=True)
        waves = np.fft.rfft(window * moving, axis=1)
        return (np.abs(waves) ** 2).sum(axis=(0, 2, 3))

    parts = [powers(nodes) for nodes in (physics, shapes, emulator, emulator - physics)]
    return Spectrum(np.fft.rfftfreq(count, dt), *parts)


def band_edges(spectrum: Spectrum, lowest: float, bins: int = 1) -> Float[np.ndarray, " E"]:
    """Return frequencies from `lowest` on, so many to an octave, until the highest is within."""
    octaves = np.log2(spectrum.frequencies.max() / lowest)
    return lowest * 2.0 ** (np.arange(int(np.ceil(octaves * bins + 1e-9)) + 1) / bins)


def in_bands(
    spectrum: Spectrum, energies: Float[np.ndarray, " M"], edges: Float[np.ndarray, " E"]
) -> Float[np.ndarray, " E-1"]:
    """Return the energies between the edges."""
    found, _ = np.histogram(spectrum.frequencies, edges, weights=energies)
    return found


def band_rows(name: str, spectra: dict[str, Spectrum]) -> Rows:
    """Return a row per octave: energies over the physics' there, and its share of all its energy above the lowest."""
    rows: Rows = []
    for what, spectrum in spectra.items():
        edges = band_edges(spectrum, LOWEST[what])
        physics, shapes, emulated, error = (
            in_bands(spectrum, energies, edges) for energies in spectrum[1:]
        )
        for band in np.flatnonzero(physics):
            rows.append(
                {
                    "body": name,
                    "in": what,
                    "from": float(edges[band]),
                    "to": float(edges[band + 1]),
                    "unit": UNITS[what],
                    "percent_of_physics": 100 * float(physics[band] / physics.sum()),
                    "emulator_over_physics": float(emulated[band] / physics[band]),
                    "shapes_over_physics": float(shapes[band] / physics[band]),
                    "error_over_physics": float(error[band] / physics[band]),
                }
            )
    return rows


def draw_spectra(found: dict[str, dict[str, Spectrum]], path: Path) -> None:
    """Draw the spectra of each body, in space above and in time below; both axes logarithmic."""
    figure = Figure(figsize=(3.4 * len(found), 6.0), layout="constrained")
    every = figure.subplots(2, len(found), squeeze=False)
    for column, (name, spectra) in enumerate(found.items()):
        for row, (what, spectrum) in enumerate(spectra.items()):
            axes = every[row][column]
            edges = band_edges(spectrum, LOWEST[what], BINS)
            middles = np.sqrt(edges[1:] * edges[:-1])
            counts = in_bands(spectrum, np.ones_like(spectrum.physics), edges)
            filled = counts > 0
            for energies, label, style in (
                (spectrum.physics, "physics", {"color": "#2b5a94", "linewidth": 2.5}),
                (spectrum.shapes, "physics from the shapes", {"color": "#4fa3a0"}),
                (spectrum.emulator, "emulator", {"color": "#e8892b"}),
                (spectrum.error, "emulator less physics", {"color": "grey", "linestyle": ":"}),
            ):
                density = in_bands(spectrum, energies, edges)[filled] / counts[filled]
                axes.loglog(middles[filled], density, label=label, **style)
            octaves = band_edges(spectrum, LOWEST[what])
            axes.set_xticks(octaves, [f"{octave:g}" for octave in octaves])
            axes.minorticks_off()
            axes.grid(alpha=0.2)
            axes.set_xlabel(UNITS[what])
            if row == 0:
                axes.set_title(name)
        every[0][0].set_ylabel("energy of a cosine over the grid [m²]")
        every[1][0].set_ylabel("power of nodes' motion [m²]")
    every[0][0].legend(fontsize="small")
    picture = io.BytesIO()
    figure.savefig(picture, format="png", dpi=90)
    write_whole(path, picture.getvalue())
