"""What a network has learnt: how velocities change with torques in one super step, beside the mass matrix of the arm."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Float

import neuroanimator as na
from classic_cases.pendulum_1998 import classic_networks
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.emulator.super_step import step
from neuroanimator.systems.rigid.mujoco_system import MujocoSystem

Rows = list[dict[str, Any]]

SUBSTEPS = (25, 50, 100)
"""Numbers of physics steps in a super step."""

MAPPED = 50
"""Number of physics steps in the super step of which every configuration is told."""

JOINTS = 3
"""Number of joints, of motors and of velocities."""

SIDE = 13
"""Number of angles of elbow and wrist, each."""

SMALL_TORQUE = 0.01
"""Share of a motor's bound by which torques are varied for differences of the physics."""


def configurations() -> Float[np.ndarray, "N 6"]:
    """Return states at rest: elbow and wrist at every pair of angles, the shoulder at random ones."""
    angles = np.linspace(-np.pi, np.pi, SIDE)
    elbow, wrist = np.meshgrid(angles, angles, indexing="ij")
    shoulder = np.random.default_rng(0).uniform(-np.pi, np.pi, elbow.size)
    still = np.zeros((elbow.size, JOINTS))
    return np.concatenate(
        [np.stack([shoulder, elbow.ravel(), wrist.ravel()], axis=1), still], axis=1
    )


def sensitivity_rows(is_quick: bool) -> Rows:
    """Return a row per emulator, configuration, joint and motor: sensitivities [rad/s per N·m] told in four ways."""
    system = na.load_system("pendulum")
    assert isinstance(system, MujocoSystem)
    states = configurations()
    masses = mass_matrices(system, states)
    damping = np.diag(system.model.dof_damping)
    rows = []
    for substeps in SUBSTEPS[:1] if is_quick else SUBSTEPS:
        dt = substeps * system.physics_dt
        known = {
            "physics": physics_jacobians(system, states, dt),
            "mass": np.linalg.inv(masses) * dt,
            # Damping taken at the end of the super step, as one implicit step has it.
            "mass_damped": np.linalg.inv(masses + dt * damping) * dt,
        }
        shipped = na.load_emulator(f"pendulum-{substeps}")
        rows += rows_of("ships", substeps, states, emulator_jacobians(shipped, states), known)
        classic = classic_networks(substeps, is_quick).emulators[0]
        rows += rows_of("classic", substeps, states, emulator_jacobians(classic, states), known)
    return rows


def mass_matrices(
    system: MujocoSystem, states: Float[np.ndarray, "N 6"]
) -> Float[np.ndarray, "N 3 3"]:
    """Return the mass matrix of the joints in each state [kg·m²]."""
    model = system.model
    data = mujoco.MjData(model)
    masses = np.zeros((len(states), JOINTS, JOINTS))
    for number, state in enumerate(states):
        system.put(data, state)
        mujoco.mj_forward(model, data)
        mujoco.mj_fullM(model, data, masses[number])
    return masses


def physics_jacobians(
    system: MujocoSystem, states: Float[np.ndarray, "N 6"], dt: float
) -> Float[np.ndarray, "N 3 3"]:
    """Return central differences of the velocities after `dt` [s] by each torque, on the true physics."""
    columns = []
    for motor in range(JOINTS):
        step_of_torque = SMALL_TORQUE * system.bounds.magnitude[motor]
        after = []
        for sign in (1.0, -1.0):
            controls = np.zeros((len(states), 1, JOINTS))
            controls[:, 0, motor] = sign * step_of_torque
            runs = system.simulate(states, controls, dt, scheme=system.fine)
            after.append(runs.states[:, 1, JOINTS:])
        columns.append((after[0] - after[1]) / (2 * step_of_torque))
    return np.stack(columns, axis=2)


def emulator_jacobians(
    emulator: Emulator, states: Float[np.ndarray, "N 6"]
) -> Float[np.ndarray, "N 3 3"]:
    """Return the derivatives of the velocities after a super step by each torque, through the network."""

    def velocities(torques: jax.Array, state: jax.Array) -> jax.Array:
        return step(emulator, state, torques)[JOINTS:]

    jacobians = jax.jit(jax.vmap(jax.jacfwd(velocities), in_axes=(None, 0)))
    return np.asarray(jacobians(jnp.zeros(JOINTS), jnp.asarray(states, jnp.float32)), float)


def rows_of(
    network: str,
    substeps: int,
    states: Float[np.ndarray, "N 6"],
    learnt: Float[np.ndarray, "N 3 3"],
    known: dict[str, Float[np.ndarray, "N 3 3"]],
) -> Rows:
    """Return the rows of one emulator."""
    rows = []
    for number, state in enumerate(states):
        for joint in range(JOINTS):
            for motor in range(JOINTS):
                row: dict[str, Any] = {"network": network, "substeps": substeps}
                row["elbow"] = float(state[1])
                row["wrist"] = float(state[2])
                row["joint"] = joint
                row["motor"] = motor
                row["learnt"] = float(learnt[number, joint, motor])
                for name, matrices in known.items():
                    row[name] = float(matrices[number, joint, motor])
                rows.append(row)
    return rows


def map_rows(rows: Rows) -> Rows:
    """Return a row per network and configuration of `MAPPED` physics steps, an entry of a matrix in each column."""
    maps: dict[tuple[str, float, float], dict[str, Any]] = {}
    for row in rows:
        if row["substeps"] != MAPPED:
            continue
        place = (row["network"], row["elbow"], row["wrist"])
        names = {"network": row["network"], "elbow": row["elbow"], "wrist": row["wrist"]}
        wide = maps.setdefault(place, names)
        for name in ("learnt", "physics", "mass"):
            wide[f"{name}_{row['joint']:.0f}{row['motor']:.0f}"] = row[name]
    return list(maps.values())


def summary_rows(rows: Rows) -> Rows:
    """Return a row per emulator: correlations of what was learnt with what is known, and its error of that."""
    summaries = []
    emulators = list(dict.fromkeys((row["network"], row["substeps"]) for row in rows))
    for network, substeps in emulators:
        chosen = [row for row in rows if row["network"] == network and row["substeps"] == substeps]
        learnt = np.array([row["learnt"] for row in chosen])
        summary: dict[str, Any] = {"network": network, "substeps": substeps}
        for name in ("physics", "mass_damped", "mass"):
            known = np.array([row[name] for row in chosen])
            summary[f"correlation_{name}"] = float(np.corrcoef(learnt, known)[0, 1])
            error = np.sqrt(np.mean((learnt - known) ** 2) / np.mean(known**2))
            summary[f"error_{name}"] = float(error)
        by_physics = np.array([row["physics"] for row in chosen])
        masses = np.array([row["mass"] for row in chosen])
        summary["correlation_physics_mass"] = float(np.corrcoef(by_physics, masses)[0, 1])
        summaries.append(summary)
    return summaries
