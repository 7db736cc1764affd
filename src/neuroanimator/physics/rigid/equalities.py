"""States that satisfy a model's equality constraints: loops that close, followers at their leaders, welds that hold.

A state is moved to a near one by Gauss-Newton steps on the residual r of its constraints and their Jacobian J,

    dq = d - W Jᵀ (J W Jᵀ + λ)⁻¹ (J d + r),

where d is the way to a wanted state, and the weights W are 0 for coordinates that must not move, and small for joints that
others follow. Joints beyond their limits are pushed back by the same steps. Velocities lose the part that would open the
constraints, so that J v = 0.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import mujoco
import numpy as np
from jaxtyping import Bool, Float, Int

from neuroanimator.files.names import model_name
from neuroanimator.physics.rigid.warnings import warnings_counted

CLOSED = 1e-3
"""Largest residual of a constraint that counts as satisfied [m or rad], in a model of 1 m or more; in a smaller one less."""

SOLVED = 1e-9
"""Residual at which steps end [m or rad]."""

MAX_WAY = 0.25
"""Maximum change of a coordinate in a step towards a wanted state [rad or m]: a loop must not flip into its other assembly,
which no motion reaches."""

MAX_WAYPOINTS = 16
"""Maximum number of these steps: a hinge half a turn away takes 13."""

CORRECTIONS = 30
"""Maximum number of steps from there to the constraints: near singular poses they converge slowly."""

MAX_STEP = 0.5
"""Maximum change of a coordinate in a step [rad or m]."""

LEADING = 1e-3
"""Weight of a joint that others follow: these move to it, not it to them."""

DAMPING = 1e-9
"""Damping λ as a share of the mean square of a row of J: redundant constraints make J W Jᵀ singular."""

LIMITS = (
    int(mujoco.mjtConstraint.mjCNSTR_LIMIT_JOINT),
    int(mujoco.mjtConstraint.mjCNSTR_LIMIT_TENDON),
)

KINDS = ("connect", "weld", "joint", "tendon")
"""MJCF's names of the equality constraints between rigid bodies, in the order of `mjtEq`."""


class Closing(NamedTuple):
    """States moved to where equality constraints are satisfied, or as near as could be."""

    states: Float[np.ndarray, "B S"]
    is_closed: Bool[np.ndarray, " B"]
    """Whether the constraints of each are satisfied."""


class _Rows(NamedTuple):
    """Residuals of constraints and their Jacobians, filled up with zeros."""

    residuals: Float[np.ndarray, "B M"]
    jacobians: Float[np.ndarray, "B M V"]
    gaps: Float[np.ndarray, " B"]
    """Largest residual of each state's equalities."""

    @property
    def errors(self) -> Float[np.ndarray, " B"]:
        """Return the largest residual of each state, of equalities or limits."""
        return np.abs(self.residuals).max(axis=1, initial=0.0)


def close_states(
    models: Callable[[Float[np.ndarray, " S"]], mujoco.MjModel],
    states: Float[np.ndarray, "B S"],
    begin: Float[np.ndarray, " S"] | None = None,
    held: Bool[np.ndarray, "2 V"] | None = None,
) -> Closing:
    """Return states near `states` (B, S), which begin with (qpos, qvel), that satisfy the equalities of their `models`.

    They are approached from the closed state `begin` (S,), so that they are assembled as it is; without it directly. `held`
    says which degrees of freedom keep their positions, and which their velocities.
    """
    bodies = [models(state) for state in states]
    if not bodies:
        return Closing(states, np.ones(0, bool))
    nq, nv = bodies[0].nq, bodies[0].nv
    weights = np.tile(_weights(bodies[0]), (2, 1))
    if held is not None:
        weights[held] = 0.0
    positions = np.array(states[:, :nq], float)
    wanted = positions.copy()

    def advance(rows: Int[np.ndarray, " N"], left: float) -> Float[np.ndarray, " N"]:
        """Take the first of the steps `left` to the wanted states in these rows; return the errors before it."""
        some = [bodies[row] for row in rows]
        moved = positions[rows]
        found = _rows(some, moved)
        ways = ways_between(some, moved, wanted[rows]) / left
        _move(some, moved, _corrected(found, ways, weights[0]))
        positions[rows] = moved
        return found.errors

    with warnings_counted:
        unfinished = np.flatnonzero(_rows(bodies, positions).gaps > SOLVED)
        # towards the wanted states
        if begin is not None:
            positions[:] = begin[:nq]
            longest = np.abs(ways_between(bodies, positions, wanted)).max(axis=1)
            counts = np.ceil(longest / MAX_WAY).clip(1, MAX_WAYPOINTS)
            for left in range(int(counts.max()), 0, -1):
                advance(np.flatnonzero(counts >= left), left)
            unfinished = np.arange(len(states))
        # onto the constraints
        for _ in range(CORRECTIONS):
            if len(unfinished):
                unfinished = unfinished[advance(unfinished, np.inf) > SOLVED]
        # along the constraints
        rows = _rows(bodies, positions)
        along = rows._replace(residuals=np.zeros_like(rows.residuals))
        velocities = states[:, nq : nq + nv]
        for _ in range(2):  # the second takes what damping has left
            velocities = _corrected(along, velocities, weights[1])
    closed = np.concatenate([positions, velocities, states[:, nq + nv :]], axis=1)
    tolerances = [CLOSED * min(1.0, float(model.stat.extent)) for model in bodies]
    return Closing(closed, rows.gaps <= tolerances)


def open_equality(model: mujoco.MjModel, state: Float[np.ndarray, " S"]) -> str:
    """Return in words which equality has the largest residual in `state`: its name, kind and residual [m or rad]."""
    with warnings_counted:
        data = mujoco.MjData(model)
        _instantiate(model, data, state[: model.nq])
    residuals = np.abs(data.efc_pos[: data.ne])
    worst = int(np.argmax(residuals))
    number = int(data.efc_id[worst])
    name = model_name(model.equality(number).name, f"equality_{number}")
    kind = KINDS[int(model.eq_type[number])]
    unit = "m" if kind == "connect" else "m or rad"
    return f"the equality '{name}' ({kind}) stays {residuals[worst]:.2g} {unit} open"


def _instantiate(
    model: mujoco.MjModel, data: mujoco.MjData, position: Float[np.ndarray, " Q"]
) -> None:
    """Let MuJoCo write the constraints at `position` into `data`: all but contacts."""
    data.qpos[:] = position
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    mujoco.mj_tendon(model, data)
    mujoco.mj_makeConstraint(model, data)


def _rows(bodies: Sequence[mujoco.MjModel], positions: Float[np.ndarray, "B Q"]) -> _Rows:
    """Return the constraints at `positions` that steps must solve: equalities, and the limits that are exceeded."""
    data = mujoco.MjData(bodies[0])
    residuals = []
    jacobians = []
    gaps = np.zeros(len(bodies))
    for row, (model, position) in enumerate(zip(bodies, positions, strict=True)):
        _instantiate(model, data, position)
        residual = data.efc_pos.copy()
        jacobian = _dense_jacobian(model, data)
        gaps[row] = np.abs(residual[: data.ne]).max(initial=0.0)
        if len(residual) > data.ne:
            kinds = data.efc_type
            is_wanted = (kinds == LIMITS[0]) | (kinds == LIMITS[1])
            is_wanted &= residual < 0
            is_wanted[: data.ne] = True
            residual = residual[is_wanted]
            jacobian = jacobian[is_wanted]
        residuals.append(residual)
        jacobians.append(jacobian)
    most = max(len(residual) for residual in residuals)
    shape = (len(bodies), most)
    filled = _Rows(np.zeros(shape), np.zeros((*shape, bodies[0].nv)), gaps)
    for row, residual in enumerate(residuals):
        filled.residuals[row, : len(residual)] = residual
        filled.jacobians[row, : len(residual)] = jacobians[row]
    return filled


def _dense_jacobian(model: mujoco.MjModel, data: mujoco.MjData) -> Float[np.ndarray, "M V"]:
    """Return the Jacobian of all constraints in `data`."""
    if not mujoco.mj_isSparse(model):
        return np.array(data.efc_J).reshape(-1, model.nv)
    jacobian = np.zeros((data.nefc, model.nv))
    mujoco.mju_sparse2dense(
        jacobian, data.efc_J, data.efc_J_rownnz, data.efc_J_rowadr, data.efc_J_colind
    )
    return jacobian


def _weights(model: mujoco.MjModel) -> Float[np.ndarray, " V"]:
    """Return how easily each degree of freedom moves: those that others follow, and which follow none, hardly do."""
    weights = np.ones(model.nv)
    is_joint = model.eq_type == mujoco.mjtEq.mjEQ_JOINT
    follows = is_joint & model.eq_active0.astype(bool) & (model.eq_obj2id >= 0)
    leaders = np.setdiff1d(model.eq_obj2id[follows], model.eq_obj1id[follows])
    weights[model.jnt_dofadr[leaders]] = LEADING
    return weights


def _corrected(
    rows: _Rows, ways: Float[np.ndarray, "B V"], weights: Float[np.ndarray, " V"]
) -> Float[np.ndarray, "B V"]:
    """Return the steps nearest to `ways` that solve the constraints' rows, by coordinates of these `weights`."""
    jacobians = rows.jacobians
    weighted = (jacobians * weights).swapaxes(1, 2)
    squares = jacobians @ weighted
    size = squares.shape[1]
    mean = np.trace(squares, axis1=1, axis2=2) / max(size, 1)
    damping = DAMPING * np.maximum(mean, DAMPING)
    squares += damping[:, None, None] * np.eye(size)
    wanted = rows.residuals + (jacobians @ ways[..., None])[..., 0]
    forces = np.linalg.solve(squares, wanted[..., None])
    return np.asarray(ways - (weighted @ forces)[..., 0])


def _move(
    bodies: Sequence[mujoco.MjModel],
    positions: Float[np.ndarray, "B Q"],
    steps: Float[np.ndarray, "B V"],
) -> None:
    """Move `positions` by `steps`, which are shortened to `MAX_STEP`."""
    longest = np.abs(steps).max(axis=1, initial=MAX_STEP)
    shortened = np.nan_to_num(steps * (MAX_STEP / longest)[:, None])
    for model, position, step in zip(bodies, positions, shortened, strict=True):
        mujoco.mj_integratePos(model, position, step, 1.0)


def ways_between(
    bodies: Sequence[mujoco.MjModel],
    positions: Float[np.ndarray, "B Q"],
    wanted: Float[np.ndarray, "B Q"],
) -> Float[np.ndarray, "B V"]:
    """Return the changes that lead from `positions` to the `wanted` ones; NaN where those are NaN."""
    ways = np.empty((len(bodies), bodies[0].nv))
    for model, way, here, there in zip(bodies, ways, positions, wanted, strict=True):
        mujoco.mj_differentiatePos(model, way, 1.0, here, there)
    return ways
