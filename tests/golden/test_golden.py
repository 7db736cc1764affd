"""Files once released load to the same predictions for ever; a changed format raises the version."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from neuroanimator import Emulator
from neuroanimator.control.policies.policy import Policy
from neuroanimator.emulator.artifact import read_metadata, save
from neuroanimator.emulator.description import FORMAT
from neuroanimator.files.atomic import read_tensors

from golden.make_golden import EMULATOR, POLICY, PREDICTIONS, controls_of  # isort: skip

TOLERANCE = 2e-5
"""Of numbers of order one: both sides are float32, and processors and versions of JAX order their sums differently."""


@pytest.fixture(scope="module")
def cases() -> dict[str, Any]:
    return json.loads(PREDICTIONS.read_text())


def test_the_golden_emulator_predicts_what_it_did(cases: dict[str, Any]):
    case = cases["emulator"]
    states = Emulator.load(EMULATOR).rollout(case["start"], case["controls"])
    np.testing.assert_allclose(states, case["states"], rtol=TOLERANCE, atol=TOLERANCE)
    assert np.ptp(case["states"], axis=0).min() > 0.01


def test_the_golden_policy_steers_as_it_did(cases: dict[str, Any]):
    case = cases["policy"]
    controls = controls_of(
        Policy.load(POLICY), *(np.array(case[key]) for key in ("states", "phases", "commands"))
    )
    np.testing.assert_allclose(controls, case["controls"], rtol=TOLERANCE, atol=TOLERANCE)
    assert np.ptp(case["controls"], axis=0).min() > 0.01


def test_a_golden_file_saved_again_has_the_same_bytes(tmp_path: Path):
    save(Emulator.load(EMULATOR), tmp_path / "e.safetensors", read_metadata(EMULATOR)["provenance"])
    assert (tmp_path / "e.safetensors").read_bytes() == EMULATOR.read_bytes()
    provenance = read_tensors(POLICY, "policy")[1]["provenance"]
    Policy.load(POLICY).save(tmp_path / "p.safetensors", provenance)
    assert (tmp_path / "p.safetensors").read_bytes() == POLICY.read_bytes()


def test_golden_files_are_small_and_of_the_format_that_is_written():
    assert EMULATOR.stat().st_size < 10_000
    assert POLICY.stat().st_size < 40_000
    assert read_metadata(EMULATOR)["format"] == FORMAT
    assert read_tensors(POLICY, "policy")[1]["format"] == Policy.FORMAT
