"""Starts that an emulator draws by itself satisfy the equalities of its system's model, where that is at hand."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from closed_chains import FOUR_BAR, assert_closed, model_of

from neuroanimator import Emulator, TrainingConfig, load_emulator
from neuroanimator.animation.motion import named_start, random_drive
from neuroanimator.gym.rules import EpisodeRules, drawn_starts, unpaid
from neuroanimator.gym.state_rows import starts_near_rest
from neuroanimator.learn.data.config import DatasetConfig
from neuroanimator.learn.data.generate import simulate_transitions
from neuroanimator.learn.training.initialise import build_emulator
from neuroanimator.physics import carried_system, tied_system
from neuroanimator.physics.loading import resolve, trust_files
from neuroanimator.physics.rigid.model_system import ModelSystem
from neuroanimator.systems.system import closed_starts

TOML = """name = "linkage"
model = "linkage.xml"
substeps = 10
[physics]
step = 0.002
truth_step = 0.002
fine_step = 0.0002
[sampling.position]
crank = 3.0
"""


@pytest.fixture(scope="module")
def linkage(tmp_path_factory: pytest.TempPathFactory) -> Emulator:
    """An untrained emulator of a four-bar linkage."""
    folder = tmp_path_factory.mktemp("linkage")
    (folder / "linkage.xml").write_text(model_of(FOUR_BAR))
    (folder / "linkage.toml").write_text(TOML)
    trust_files(folder / "linkage.toml")
    name, definition, substeps = resolve(str(folder / "linkage.toml"))
    config = DatasetConfig(
        system=name, definition=definition, substeps=substeps, count=720, samples_per_run=36
    )
    return build_emulator(simulate_transitions(config), TrainingConfig(widths=(8,)))


@pytest.fixture(scope="module")
def system(linkage: Emulator) -> ModelSystem:
    found = carried_system(linkage.system, linkage.definition)
    assert isinstance(found, ModelSystem)
    return found


def generators(count: int) -> list[np.random.Generator]:
    return [np.random.default_rng(seed) for seed in range(count)]


def test_a_file_says_that_its_system_is_tied(linkage: Emulator, shipped: Emulator, tmp_path: Path):
    linkage.save(tmp_path / "linkage.emulator.safetensors")
    assert load_emulator(tmp_path / "linkage.emulator.safetensors").spec.is_tied
    assert not shipped.spec.is_tied


def test_random_motions_begin_closed(linkage: Emulator, system: ModelSystem):
    starts = [random_drive(linkage, 0.1, seed, system=system).start for seed in range(5)]
    assert_closed(system, np.stack(starts))
    assert np.ptp([start[0] for start in starts]) > 0.1


def test_a_start_of_the_command_line_is_closed(linkage: Emulator, system: ModelSystem):
    start = named_start(linkage, ["crank=0.7"], system)
    assert start[0] == 0.7
    assert_closed(system, start[None])


def test_episodes_begin_closed_also_by_rules_of_a_user(linkage: Emulator, system: ModelSystem):
    assert_closed(system, starts_near_rest(linkage, 3.0, generators(20)))

    def draw(rng: np.random.Generator) -> np.ndarray:
        return linkage.rest + rng.normal(size=6) * 0.2

    starts = drawn_starts(EpisodeRules(unpaid, draw_start=draw), linkage, generators(20))
    assert_closed(system, starts)
    assert starts[:, 0].std() > 0.05


def test_without_its_model_an_emulator_begins_at_rest(linkage: Emulator):
    definition = linkage.definition.replace('"sha256":{"', '"sha256":{"no-')
    assert definition != linkage.definition
    alone = replace(linkage, spec=replace(linkage.spec, definition=definition))
    drawn = linkage.rest + np.random.default_rng(0).normal(size=(3, 6))
    np.testing.assert_array_equal(
        closed_starts(alone.spec, drawn, tied_system(alone.spec)), np.tile(linkage.rest, (3, 1))
    )
