"""Columns called as the numbers of a system are need neither a unit nor a kind; what may be several is refused."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from neuroanimator.errors import BadFileError
from neuroanimator.physics.recorded.recording import parse_recording

ARM = {
    "state": ["s rad", "e rad", "s.velocity rad/s", "e.velocity rad/s"],
    "control": ["s N·m", "e N·m"],
}
"""A shoulder and an elbow, whose motors are called as their joints are."""

PUCK = {"state": ["place.0 m", "place.1 m", "hand m"], "control": ["force N"]}


def rows(count: int, seed: int = 0) -> list[str]:
    table = np.random.default_rng(seed).uniform(-1, 1, (40, count))
    return [
        ",".join([f"{k / 50:.2f}", *(f"{value:.6f}" for value in row)])
        for k, row in enumerate(table)
    ]


def columns(header: str, vocabulary: dict[str, list[str]]) -> list[str]:
    lines = [header, *rows(header.count(","))]
    found = parse_recording("\n".join(lines).encode(), "a.csv", vocabulary)
    state = [f"state.{' '.join(column)}" for column in found.state]
    return state + [f"control.{' '.join(column)}" for column in found.control]


def test_units_and_kinds_follow_from_the_system():
    expected = ["state.s rad", "state.e rad", "control.s N·m"]
    assert columns("time,s,e,control.s", {**ARM, "control": ["s N·m"]}) == expected
    for time, s, e in product(
        ("time", "time s", "Time [s]"),
        ("s rad", "state.s", "state.s rad", "s[0] rad", "s (deg)"),
        ("e rad", "e [rad]", "state.e"),
    ):
        assert columns(f"{time},{s},{e}", ARM) == expected[:2]
    assert columns("time,hand,force", PUCK) == ["state.hand m", "control.force N"]
    assert columns("time,place.1,place[0]", PUCK) == ["state.place.1 m", "state.place.0 m"]
    assert columns("time,hand mm,place.0 cm", PUCK) == ["state.hand m", "state.place.0 m"]


def test_what_may_be_several_is_refused_with_all_of_them():
    for header in ("time,s,e rad", "time,s,e,s.velocity"):
        with pytest.raises(
            BadFileError, match=r"column 2: 's' may be 'state.s rad', 'control.s N·m'"
        ):
            columns(header, ARM)
    assert columns("time,s,control.s,e rad,control.e", ARM) == [
        "state.s rad",
        "state.e rad",
        "control.s N·m",
        "control.e N·m",
    ]


@pytest.mark.parametrize(
    ("header", "message"),
    [
        ("time,hant", "column 2: 'hant' is no column of the emulator. Did you mean hand m"),
        ("time,hand rad", "column 2: column 'state.hand' is in rad, the emulator's in m"),
        ("time,hand,state.hand m", "two columns are called 'state.hand'"),
        ("time,force", "no state column"),
        ("hand,force", "no column 'time s'"),
    ],
)
def test_names_of_nothing_are_refused_by_column(header: str, message: str):
    with pytest.raises(BadFileError) as caught:
        columns(header, PUCK)
    assert message in str(caught.value)


def test_without_a_system_names_need_their_units():
    content = "\n".join(["time s,angle", *rows(1)]).encode()
    with pytest.raises(BadFileError, match="column 2: 'angle' is none of run, time s"):
        parse_recording(content, "a.csv")
