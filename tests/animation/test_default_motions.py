"""What shipped systems are shown with keeps our own rule: it stays where the emulator was trained."""

from __future__ import annotations

import json

import numpy as np
import pytest

from neuroanimator import is_reached, load_emulator, load_system
from neuroanimator.animation.motion import default_drive, random_drive
from neuroanimator.emulator.trust_summary import summary_of
from neuroanimator.files.zoo import DEFAULT_MOTIONS, SHIPPED, SOFT

SYSTEMS = sorted({system for system, _ in [*SHIPPED, *SOFT]})

TRUSTED = 0.99
"""Least share of a film's time that is trusted."""

SEED_TRUSTED = 0.75
"""Least share of time that is trusted of motions at random."""

MAX_FILE = 100_000
"""Largest file of all motions [bytes]."""


QUICK = ("fish", "flag", "lander", "pendulum")
"""One of each kind: of mass points, soft, free, and of hinges. The others' films run in `make endurance`."""


@pytest.mark.parametrize(
    "system",
    [
        name if name in QUICK else pytest.param(name, marks=pytest.mark.endurance)
        for name in SYSTEMS
    ],
)
def test_every_default_film_is_trusted(system: str):
    emulator = load_emulator(system)
    _, scores = default_drive(emulator).trusted_motion(emulator)
    trust = summary_of(emulator, scores)
    assert trust.has_meter
    assert trust.share_within >= TRUSTED, trust


def test_every_system_has_a_film_in_one_small_file():
    assert sorted(json.loads(DEFAULT_MOTIONS.read_text())) == SYSTEMS
    assert DEFAULT_MOTIONS.stat().st_size <= MAX_FILE


def test_the_arm_is_seen_standing_for_a_second():
    emulator = load_emulator("pendulum")
    system = load_system("pendulum")
    states = default_drive(emulator).motion(emulator)
    standing = [is_reached(system, "upright", state) for state in states]
    assert all(standing[-round(1.0 / emulator.dt) :])
    assert not any(standing[: len(standing) // 2])


@pytest.mark.parametrize("substeps", [25, 100])
def test_at_another_super_step_it_takes_as_long(substeps: int):
    usual = load_emulator("truck-50")
    other = load_emulator(f"truck-{substeps}")
    drive = default_drive(other)
    seconds = len(default_drive(usual).controls) * usual.dt
    assert len(drive.controls) * other.dt == pytest.approx(seconds)
    np.testing.assert_array_equal(drive.start, default_drive(usual).start)


def test_soft_bodies_at_random_stay_within_training():
    """What moves them keeps within reach, as in training: of the liveliest of its paths some are beyond the meter's edge."""
    for name, _ in SOFT:
        emulator = load_emulator(name)
        trusted = []
        for seed in range(8):
            _, scores = random_drive(emulator, 5.0, seed).trusted_motion(emulator)
            trusted.append((scores < 1).mean())
        assert np.mean(trusted) > SEED_TRUSTED, f"{name}: {trusted}"
