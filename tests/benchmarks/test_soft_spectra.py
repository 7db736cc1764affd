"""Spectra of soft bodies say where in space and time the energy is."""

from __future__ import annotations

import numpy as np
import pytest
from large_bodies_cases.spectra import (
    band_edges,
    grid_frequencies,
    in_bands,
    spectrum_in_space,
    spectrum_in_time,
)
from soft_meshes import flag, jelly


@pytest.mark.parametrize("shape", [(20, 30), (8, 6, 6)])
def test_energy_in_space_is_that_of_all_nodes(shape: tuple[int, ...]):
    nodes = flag(*shape) if len(shape) == 2 else jelly(*shape[:2])
    moved = np.random.default_rng(0).normal(size=(2, *nodes.shape))
    frequencies = grid_frequencies(nodes, shape, 1.0)
    spectrum = spectrum_in_space(shape, frequencies, moved, moved, moved)
    assert spectrum.physics.sum() == pytest.approx((moved**2).sum())
    assert not spectrum.error.any()


def test_a_wave_along_a_flag_lies_in_the_octave_of_its_frequency():
    shape = (20, 30)
    nodes = flag(*shape)
    column = (np.arange(30) + 0.5) / 30
    moved = np.zeros((1, *nodes.shape))
    moved[0, :, 1] = np.tile(np.cos(2 * np.pi * 3 * column), 20)
    frequencies = grid_frequencies(nodes, shape, 1.2)
    spectrum = spectrum_in_space(shape, frequencies, moved, moved, moved)
    found = in_bands(spectrum, spectrum.physics, band_edges(spectrum, 1.0))
    assert found[1] == pytest.approx((moved**2).sum())  # 2 to 4


def test_a_swing_lies_in_the_octave_of_its_frequency():
    dt = 1 / 30
    swing = np.sin(2 * np.pi * 3 * dt * np.arange(240))[None, :, None, None] * np.ones(3)
    spectrum = spectrum_in_time(dt, swing, swing, 2 * swing)
    edges = band_edges(spectrum, 0.5)
    found = in_bands(spectrum, spectrum.physics, edges)
    assert found[2] > 0.999 * found.sum()  # 2 to 4 Hz
    np.testing.assert_allclose(in_bands(spectrum, spectrum.emulator, edges), 4 * found)
