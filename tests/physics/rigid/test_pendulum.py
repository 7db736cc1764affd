"""The physics obeys the laws it claims."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from neuroanimator import NeuroAnimatorError, load_system
from neuroanimator.physics.rigid.mujoco_system import MujocoSystem
from neuroanimator.systems.system import Scheme


def pendulum(name: str = "pendulum") -> MujocoSystem:
    system = load_system(name)
    assert isinstance(system, MujocoSystem)
    return system


def energy(system: MujocoSystem, state: np.ndarray) -> float:
    data = mujoco.MjData(system.model)
    data.qpos[:], data.qvel[:] = state[:3], state[3:]
    mujoco.mj_forward(system.model, data)
    mujoco.mj_energyPos(system.model, data)
    mujoco.mj_energyVel(system.model, data)
    return float(data.energy.sum())


def test_the_frictionless_passive_pendulum_keeps_its_energy():
    system = pendulum("pendulum-passive")
    system.model.dof_damping[:] = 0
    start = np.array([[2.0, 0.5, -0.3, 0.0, 1.0, 0.0]])
    runs = system.simulate(start, np.zeros((1, 40, 3)), 0.05, scheme=Scheme("rk4", 0.001))
    energies = [energy(system, state) for state in runs.states[0]]
    assert np.ptp(energies) < 1e-6 * abs(energies[0])


def test_friction_never_adds_energy():
    system = pendulum("pendulum-passive")
    runs = system.simulate(np.array([[2.0, 0.5, -0.3, 0.0, 1.0, 0.0]]), np.zeros((1, 60, 3)), 0.05)
    energies = np.array([energy(system, state) for state in runs.states[0]])
    assert (np.diff(energies) < 1e-6).all()
    assert energies[-1] < energies[0] - 0.1


@pytest.mark.parametrize("name", ["pendulum", "pendulum-passive"])
def test_the_mirrored_motion_is_the_motion_mirrored(name: str):
    system, rng = pendulum(name), np.random.default_rng(0)
    starts = system.sample_starts(rng, 20)
    controls = rng.uniform(-1, 1, (20, 10, 3)) * system.bounds.half
    motion, mirrored = (
        system.simulate(sign * starts, sign * controls, 0.05).states for sign in (1, -1)
    )
    np.testing.assert_allclose(mirrored, -motion, atol=1e-6)


def test_the_truth_converges_with_fourth_order_and_has_converged():
    system, rng = pendulum(), np.random.default_rng(1)
    starts, controls = (
        system.sample_starts(rng, 50),
        rng.uniform(-0.5, 0.5, (50, 1, 3)) * system.bounds.half,
    )
    exact = system.simulate(starts, controls, 0.05, scheme=Scheme("rk4", 1e-4)).states[:, 1]
    errors = [
        np.sqrt(
            np.mean(
                (
                    system.simulate(starts, controls, 0.05, scheme=Scheme("rk4", dt)).states[:, 1]
                    - exact
                )
                ** 2
            )
        )
        for dt in (0.01, 0.005, 0.0025)
    ]
    assert errors[0] / errors[1] > 12
    assert errors[1] / errors[2] > 12
    assert errors[1] < 1e-4


def test_threads_do_not_change_a_bit():
    system, rng = pendulum(), np.random.default_rng(2)
    starts, controls = (
        system.sample_starts(rng, 64),
        rng.uniform(-1, 1, (64, 5, 3)) * system.bounds.half,
    )
    one, many = (
        system.simulate(starts, controls, 0.05, threads=threads).states for threads in (1, 3)
    )
    assert one.tobytes() == many.tobytes()


def test_a_diverged_run_is_detected_and_not_reset():
    system = pendulum()
    starts = np.array([[0.0, 0, 0, 0, 0, 0], [0.0, 0, 0, 1e5, -1e5, 1e5]])
    runs = system.simulate(starts, np.zeros((2, 5, 3)), 0.05, scheme=Scheme("euler", 0.05))
    assert runs.has_diverged.tolist() == [False, True]


def test_the_motors_can_hold_the_arm_level_and_weak_ones_cannot():
    from neuroanimator.physics.rigid.pendulum import MOTOR_TORQUE

    system = pendulum()
    data = mujoco.MjData(system.model)
    data.qpos[:] = [np.pi / 2, 0, 0]
    mujoco.mj_forward(system.model, data)
    needed = np.abs(data.qfrc_bias)
    assert (needed < MOTOR_TORQUE).all()
    weak = (10.0, 5.0, 1.5)  # pumps like a child on a swing
    assert (needed > weak).all()


def test_bad_numbers_are_refused_by_name():
    system = pendulum()
    with pytest.raises(
        NeuroAnimatorError,
        match=r"No system called 'pendlum'. Did you mean pendulum\? Systems: cape, cube, dolphin, fish, ",
    ):
        load_system("pendlum")
    with pytest.raises(
        NeuroAnimatorError,
        match=r"torque\[1\] N·m out of bounds; wanted between -14 and 14, got 15",
    ):
        system.simulate(np.zeros((1, 6)), np.array([[[0.0, 15, 0]]]), 0.05)
    with pytest.raises(NeuroAnimatorError, match=r"state: velocity\[0\] rad/s is not finite"):
        system.simulate(np.array([[0.0, 0, 0, np.nan, 0, 0]]), np.zeros((1, 1, 3)), 0.05)
    with pytest.raises(NeuroAnimatorError, match="wanted 6 numbers"):
        system.simulate(np.zeros((1, 5)), np.zeros((1, 1, 3)), 0.05)
    with pytest.raises(NeuroAnimatorError, match="not a whole number"):
        system.simulate(np.zeros((1, 6)), np.zeros((1, 1, 3)), 0.0512)
