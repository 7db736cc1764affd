"""A pilot moves on like its policy and emulator do, at any rate, and goes where it is told."""

from __future__ import annotations

import math
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from shapes import unchecked

from neuroanimator import (
    NeuroAnimatorError,
    Pilot,
    Policy,
    load_emulator,
    load_policy,
    load_system,
    read_pose,
)
from neuroanimator.control import EmulatorPlant, ParameterEstimator
from neuroanimator.control.policies.closed_loop import choose_controls
from neuroanimator.control.policies.pilot import MAX_LEAD, PilotFrame
from neuroanimator.control.policies.policy import fresh_policy
from neuroanimator.control.policies.steering import SteeringTarget


@pytest.fixture(scope="module")
def policy() -> Policy:
    return load_policy("fish")


@pytest.fixture
def pilot(policy: Policy) -> Pilot:
    return Pilot(policy)


def steered(pilot: Pilot, rate: float, seconds: float, **asked: float) -> list[PilotFrame]:
    frames = [pilot.reset()]
    return frames + [pilot.step(dt=1 / rate, **asked) for _ in range(round(seconds * rate))]


def test_in_super_steps_it_is_the_emulators_motion_under_the_policys_muscles(
    pilot: Pilot, policy: Policy
):
    emulator, speed = policy.emulator, 0.08
    latent = jnp.asarray(emulator.encode(emulator.rest), jnp.float32)[None]
    advance = eqx.filter_jit(
        lambda e, latent, u: e.step_latent(latent[0], e.encode_control(u[0]))[None]
    )
    choose = eqx.filter_jit(choose_controls)
    target, phase, states = (
        SteeringTarget(jnp.array([[1.0, 0, 0]]), jnp.array([speed])),
        jnp.zeros(1),
        [],
    )
    for _ in range(15):
        controls = choose(policy, latent, phase, target)
        latent, phase = advance(emulator, latent, controls), phase + policy.tick
        states.append(np.asarray(emulator.decode(np.asarray(latent[0]))))
    frames = steered(pilot, 1 / policy.dt, 15 * policy.dt, speed=speed)
    np.testing.assert_allclose([frame.state for frame in frames[1:]], states, atol=2e-3)
    assert np.ptp([frame.pose.position[0] for frame in frames]) > 0.02


@pytest.mark.parametrize("rate", [5.0, 24.0, 60.0, 240.0])
def test_the_way_does_not_depend_on_the_rate_it_is_looked_at(rate: float, pilot: Pilot):
    often = steered(pilot, 120.0, 2.0, speed=0.1, turn=0.5)
    frames = steered(pilot, rate, 2.0, speed=0.1, turn=0.5)
    assert frames[-1].time == pytest.approx(2.0)
    np.testing.assert_allclose(frames[-1].state, often[-1].state, atol=1e-5)


def test_nothing_jumps_between_frames(pilot: Pilot):
    frames = steered(pilot, 240.0, 2.0, speed=0.1, turn=0.5)
    positions = np.array([frame.pose.position for frame in frames])
    assert np.linalg.norm(np.diff(positions, axis=0), axis=1).max() < 2 * pilot.top_speed / 240
    pose = read_pose(load_system("fish").structure, frames[7].state)
    np.testing.assert_allclose(frames[7].pose.forward, pose.forward)


@pytest.mark.parametrize("side", [1, -1])
def test_it_turns_to_the_side_it_is_told_and_then_holds_its_heading(side: int, pilot: Pilot):
    speed = 0.6 * pilot.top_speed
    for picture in range(240):
        pilot.step(speed=speed, turn=side * 0.4 * (picture < 90), dt=1 / 30)
    wanted = side * 0.4 * 3.0
    headings = [
        math.atan2(*pilot.step(speed=speed, dt=1 / 30).pose.forward[1::-1]) for _ in range(36)
    ]
    assert np.mean(headings) == pytest.approx(wanted, abs=0.1)


def test_what_it_cannot_follow_is_not_saved_up(pilot: Pilot):
    pilot.step(speed=0.05, turn=40.0, dt=1.0)
    heading = [math.atan2(*pilot.step(speed=0.05, dt=0.1).pose.forward[1::-1]) for _ in range(40)]
    assert 0 < np.unwrap(heading)[-1] < 2 * MAX_LEAD


def test_told_to_climb_it_rises_and_to_dive_it_sinks(pilot: Pilot):
    ends = [
        steered(pilot, 10.0, 5.0, speed=0.1, climb=climb)[-1].pose.position[2]
        for climb in (-0.4, 0.0, 0.4)
    ]
    assert ends[0] + 0.03 < ends[1] < ends[2] - 0.03


def test_reset_begins_again_to_the_same_frames(pilot: Pilot):
    first, again = (steered(pilot, 30.0, 1.0, speed=0.1, turn=0.3) for _ in range(2))
    for one, other in zip(first, again, strict=True):
        np.testing.assert_array_equal(one.state, other.state)
    other_beat = pilot.reset(phase=1.0)
    np.testing.assert_array_equal(other_beat.state, first[0].state)
    assert not np.array_equal(pilot.step(speed=0.1, dt=0.1).state, first[3].state)


def test_its_muscles_steer_the_true_physics(pilot: Pilot):
    system = load_system("fish")
    state, dt = np.array(system.rest), pilot.policy.dt
    for _ in range(round(3.0 / dt)):
        pilot.step(speed=0.08, dt=dt, state=state)
        held = system.bounds.clip(pilot.controls)
        state = system.simulate(state[None], held[None, None], dt).states[0, -1]
    pose = read_pose(system.structure, state)
    assert pose.position[0] - read_pose(system.structure, system.rest).position[0] > 0.1
    assert math.degrees(math.atan2(abs(pose.forward[1]), pose.forward[0])) < 25


def test_frames_make_a_clip_and_bones(pilot: Pilot):
    frames = steered(pilot, 60.0, 0.5, speed=0.1)
    clip = pilot.clip(frames)
    assert clip.rate == pytest.approx(60.0)
    assert (clip.name, clip.states.shape) == ("fish", (31, len(frames[0].state)))
    positions, orientations = pilot.bones(frames[-1])
    assert positions.shape == (len(clip.skeleton.bones), 3)
    np.testing.assert_allclose(np.linalg.norm(orientations, axis=1), 1)


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        ({"speed": math.nan}, "speed: wanted a finite number, got nan"),
        ({"speed": "fast"}, "speed: wanted a finite number, got 'fast'"),
        ({"speed": 0.1, "turn": math.inf}, "turn: wanted a finite number, got inf"),
        ({"speed": 0.1, "climb": math.nan}, "climb: wanted a finite number"),
        ({"speed": 0.1, "dt": 0.0}, "dt: wanted more than 0 s and at most 60 s, got 0"),
        ({"speed": 0.1, "dt": 1000.0}, "dt: wanted more than 0 s and at most 60 s, got 1000"),
        ({"speed": 0.1, "state": [1.0, 2.0]}, "state: wanted"),
        ({"speed": 0.1, "state": np.zeros((2, 150))}, "state: wanted one of 150 numbers"),
    ],
)
def test_what_is_asked_that_makes_no_sense_is_refused_and_changes_nothing(
    asked: dict[str, Any], message: str, pilot: Pilot
):
    pilot.reset()
    with pytest.raises(NeuroAnimatorError, match=message):
        unchecked(Pilot.step)(pilot, **asked)
    before, after = pilot.step(speed=0.1), Pilot(pilot.policy).step(speed=0.1)
    np.testing.assert_array_equal(before.state, after.state)


def test_frames_that_make_no_clip_are_refused(pilot: Pilot):
    frames = steered(pilot, 60.0, 0.1, speed=0.1)
    for wrong in (frames[:1], [frames[0], frames[1], frames[5]], [frames[1], frames[0]]):
        with pytest.raises(NeuroAnimatorError, match="frames: wanted two or more, evenly spaced"):
            pilot.clip(wrong)


def test_a_policy_is_found_by_name_or_file_and_others_are_refused_by_name(tmp_path):
    load_policy("fish").save(tmp_path / "mine.policy.safetensors")
    assert Policy.load(tmp_path / "mine.policy.safetensors").dt == Policy.load("fish").dt
    for load in (load_policy, Policy.load, Pilot):
        with pytest.raises(
            NeuroAnimatorError, match="No policy file 'whale', .* Shipped: dolphin, fish"
        ):
            load("whale")


@pytest.fixture(scope="module")
def family(policy: Policy) -> Policy:
    """A policy of the family of fish that has not been trained: it swims by their gait."""
    return fresh_policy(load_emulator("fishes"), policy.ranges, (8,))


@pytest.mark.endurance  # tests/learn/identification/test_identify.py estimates parameters in a loop
def test_with_an_estimator_it_finds_out_whose_muscles_it_moves(family: Policy):
    """The emulator itself stands in for the body, so that nothing but parameters differs."""
    emulator = family.emulator
    nominal = emulator.rest
    true = emulator.at(length=0.3, stiffness=0.8, density=1.2).rest
    entries = list(emulator.parameter_entries)
    pilot = Pilot(family, estimator=ParameterEstimator(emulator, windows=4))
    plant = EmulatorPlant(emulator)
    state = true
    told = state
    for _ in range(25):
        told = state.copy()
        told[entries] = nominal[entries]
        pilot.step(speed=0.1, dt=family.dt, state=told)
        state = plant(state, pilot.controls)
    assert pilot.estimator is not None
    np.testing.assert_allclose(pilot.estimator.values, true[entries], rtol=0.02)
    informed = Pilot(family).reset(true).state
    begun = pilot.reset(np.concatenate([true[: -len(entries)], nominal[entries]]))
    np.testing.assert_allclose(begun.state, informed, rtol=0.02, atol=1e-6)


def test_states_that_tell_an_estimator_nothing_are_refused(family: Policy, policy: Policy):
    estimator = ParameterEstimator(family.emulator)
    pilot = Pilot(family, estimator=estimator)
    state = pilot.reset().state
    pilot.step(speed=0.1, dt=family.dt, state=state)
    for dt in (0.5 * family.dt, 1.5 * family.dt):
        pilot.reset(state)
        pilot.step(speed=0.1, dt=dt)
        with pytest.raises(NeuroAnimatorError, match="one super step, 0.1 s, apart"):
            pilot.step(speed=0.1, dt=family.dt, state=state)
    with pytest.raises(NeuroAnimatorError, match="one of the policy's body, fish, got one of"):
        Pilot(policy, estimator=estimator)
