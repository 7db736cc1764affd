"""Animals' tasks start upright, and count no motion that ends on its side."""

from __future__ import annotations

import numpy as np
import pytest

from neuroanimator import load_system, read_pose
from neuroanimator.learn.tasks.swimmers import (
    LEVEL_WITHIN,
    SWIMMER_TASKS,
    UPRIGHT_WITHIN,
    ends_upright,
    swimming_start,
    turned_upright,
)
from neuroanimator.physics.deformable.deformable_system import DeformableSystem
from neuroanimator.state.rotation import rotate
from neuroanimator.systems.system import System

DT = 0.05


@pytest.fixture(scope="module", params=["fish", "dolphin"])
def animal(request: pytest.FixtureRequest) -> DeformableSystem:
    system = load_system(request.param)
    assert isinstance(system, DeformableSystem)
    return system


def rolled(system: DeformableSystem, state: np.ndarray, angle: float) -> np.ndarray:
    """Return `state` (S,) rolled to its right about its own axis by `angle` [rad]."""
    pose = read_pose(system.structure, state)
    orientation = np.array([np.cos(angle / 2), *(np.sin(angle / 2) * pose.forward)])
    positions, velocities, activations = system.unpack(state)

    def turned(vectors):
        return rotate(np.broadcast_to(orientation, (len(vectors), 4)), vectors)

    return system.pack(
        turned(positions - pose.position) + pose.position, turned(velocities), activations
    )


def test_swimmers_start_nearly_level_and_upright(animal: DeformableSystem):
    for seed in range(3):
        pose = read_pose(animal.structure, swimming_start(animal, np.random.default_rng(seed)))
        assert abs(pose.forward[2]) < LEVEL_WITHIN
        assert pose.upward[2] > UPRIGHT_WITHIN


def test_turning_a_body_upright_changes_nothing_else(animal: DeformableSystem):
    state = rolled(animal, swimming_start(animal, np.random.default_rng(1)), 2.0)
    upright = turned_upright(animal, state)
    before, after = (read_pose(animal.structure, each) for each in (state, upright))
    assert after.forward == pytest.approx([1, 0, 0], abs=1e-9)
    assert after.roll == pytest.approx(0, abs=1e-9)
    assert after.position == pytest.approx(before.position)
    assert after.velocity @ after.forward == pytest.approx(before.velocity @ before.forward)
    positions, again = (animal.unpack(each)[0] for each in (state, upright))

    def apart(points):
        return np.linalg.norm(points[:, None] - points[None], axis=-1)

    np.testing.assert_allclose(apart(again), apart(positions), atol=1e-12)


@pytest.mark.parametrize("angle", [-2.5, -0.6, 0.6, 2.5])
def test_a_motion_that_ends_on_its_side_is_no_success(angle: float, animal: DeformableSystem):
    assert animal.gait is not None
    still = np.repeat(animal.rest[None], 41, axis=0)
    assert ends_upright(animal, still, DT)
    assert not ends_upright(
        animal, np.append(still, rolled(animal, animal.rest, angle)[None], axis=0), DT
    )
    for when, verdict in ((round(animal.gait.period / DT) - 1, False), (20, True)):
        shaken = still.copy()
        shaken[-1 - when] = rolled(animal, animal.rest, angle)
        assert ends_upright(animal, shaken, DT) == verdict


@pytest.mark.parametrize("task", SWIMMER_TASKS, ids=lambda task: task.name)
def test_every_task_of_animals_says_that_it_counts_roll(task):
    assert "rolled by less than 30°" in task.success


def flying(system: System, trial, angle: float) -> np.ndarray:
    """Return a motion (3, S) that is up in the air in the middle, there rolled by `angle` [rad]."""
    assert isinstance(system, DeformableSystem)
    states = np.repeat(trial.start[None], 3, axis=0)
    states[1] = rolled(system, turned_upright(system, trial.start), angle)
    states[1, 2 : 3 * len(system.body.masses) : 3] += (
        1.0 - read_pose(system.structure, states[1]).position[2]
    )
    return states


def test_a_leap_counts_back_up_only():
    task, system = SWIMMER_TASKS[-2], load_system("dolphin")
    trial = task.draw(system, np.random.default_rng(0), 60, DT)
    verdicts = [
        trial.is_success(flying(system, trial, angle)) for angle in (0.0, 0.4, 0.7, -0.7, np.pi)
    ]
    assert verdicts == [True, True, False, False, False]
    assert not trial.is_success(np.repeat(trial.start[None], 3, axis=0))
