"""The page about the network of 1998 says what its tables say; its searches and spectra obey their laws."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from classic_cases.motion_spectra import SAMPLE_DT, band_powers, interpolate
from classic_cases.page import tables
from classic_cases.pictures import PICTURES
from classic_cases.surfaces import TwoTorques, minima, torque_rows
from control_cases.baselines.genetic import MAX_GENE, children_of, winners

from neuroanimator import load_system

DOCS = Path(__file__).parents[2] / "docs"
PAGE = DOCS / "classic.md"

MAX_PICTURE = 60_000
"""Largest picture of the page [bytes]."""

DECIMAL = re.compile(r"\d[\d,]*\.\d+")
TABLE = re.compile(r"^\|.*\|$", re.MULTILINE)
QUOTE = re.compile(r"^>.*$", re.MULTILINE)
CODE = re.compile(r"^```.*?^```$", re.MULTILINE | re.DOTALL)
TARGET = re.compile(r"\]\([^)]*\)")


def test_the_tables_of_the_page_are_those_the_benchmark_wrote():
    text = PAGE.read_text(encoding="utf-8")
    for table in tables():
        assert table in text


def test_every_decimal_in_the_text_stands_in_a_table_of_its_section():
    sections = PAGE.read_text(encoding="utf-8").split("\n## ")
    for section in sections:
        figures = set(DECIMAL.findall("\n".join(TABLE.findall(section))))
        prose = section
        for pattern in (TABLE, QUOTE, CODE, TARGET):
            prose = pattern.sub("", prose)
        assert set(DECIMAL.findall(prose)) <= figures, section.splitlines()[0]


def test_the_page_shows_every_picture_and_all_are_small():
    text = PAGE.read_text(encoding="utf-8")
    shown = {Path(name).stem for name in re.findall(r"\(images/classic/([\w-]+\.png)\)", text)}
    assert shown == {*PICTURES}
    for name in shown:
        assert (DOCS / "images" / "classic" / f"{name}.png").stat().st_size <= MAX_PICTURE


def test_children_stay_within_bounds_and_equal_parents_differ_by_mutation_alone():
    rng = np.random.default_rng(0)
    genes = np.full((200, 30), MAX_GENE)
    children = children_of(genes, np.zeros(200), rng)
    assert children.max() == MAX_GENE
    changed = (children != MAX_GENE).sum(axis=1)
    # Two of a child's genes mutate in the mean; half of these leave the bounds and are brought back.
    assert changed.mean() == pytest.approx(1.0, abs=0.3)


def test_winners_of_tournaments_are_better_than_the_rest():
    costs = np.random.default_rng(0).normal(size=500)
    chosen = winners(costs, np.random.default_rng(1))
    # The least of three is below the median seven times of eight.
    assert (costs[chosen] < np.median(costs)).mean() == pytest.approx(7 / 8, abs=0.06)


def test_the_power_of_a_swing_lies_in_its_band_and_is_half_its_square():
    time = SAMPLE_DT * np.arange(8_000)
    swing = np.zeros((1, len(time), 3))
    swing[0, :, 1] = 3.0 * np.sin(2 * np.pi * 3 * time)
    powers = band_powers(swing, SAMPLE_DT, np.array([0.5, 2.0, 4.0, 8.0]))
    np.testing.assert_allclose(powers, [0.0, 4.5, 0.0], atol=0.02)


def test_interpolation_keeps_every_sample_and_straight_lines():
    line = np.arange(5.0)[None, :, None] * np.ones(3)
    drawn = interpolate(line, 4)
    assert drawn.shape == (1, 17, 3)
    np.testing.assert_allclose(drawn[0, :, 0], np.arange(17) / 4)


def test_minima_of_waves_are_counted():
    grid = np.linspace(0, 4 * np.pi, 81)
    waves = np.cos(grid)[:, None] + np.cos(grid)[None]
    assert minima(waves) == 4


def test_two_torques_drive_the_shoulder_alone_and_are_guessed_back():
    parameters = TwoTorques.of(10, load_system("pendulum"))
    z = np.array([0.3, -0.8])
    controls = np.asarray(parameters.controls(z), float)
    assert not controls[:, 1:].any()
    assert len(np.unique(controls[:, 0])) == 2
    np.testing.assert_allclose(parameters.guess(controls), z, atol=1e-5)


def test_a_small_surface_is_the_same_on_the_emulator_and_on_the_physics():
    rows = torque_rows(is_quick=True)
    emulated = np.array([row["j_emulator"] for row in rows])
    true = np.array([row["j_physics"] for row in rows])
    np.testing.assert_allclose(np.log(emulated), np.log(true), atol=0.2)
