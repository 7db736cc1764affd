"""The authors' model with parameters fitted by us: least squares on MuJoCo's rollouts over windows of the training part.

This is the opponent of identification through an emulator. Residuals are differences of angles over half-second windows
(of positions and rotations over eighty steps of a toss), softened by SciPy's `soft_l1`; slopes are finite differences, a
rollout of all windows a parameter. Bounds: ±30 % of the authors' value; inertias a third to five times (some of theirs lie
on the bounds of their own fit); damping to fifty times, friction to five times; Coulomb friction, where their model has none,
from nothing to 0.01 N·m. A weak pull towards the authors' values decides what the recording cannot (all masses together, for
one).

The cube is another model, whose corners are rounded; of it everything is fitted that its motion shows: how the contact gives
way and slides, inertia, size, the radius of the corners, gravity (lengths are measured 2 % short), the board's tilt and
height, and the centre of mass.

What limits it: one law of friction (viscous and Coulomb) for bearings whose friction depends on load and position; a cart and
a frame held fixed that give a little; torques known from the motors' currents, late by an unknown part of a sample; starts that
are measured, not fitted.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import mujoco
import numpy as np
from jaxtyping import Float
from scipy.optimize import least_squares

from benchmarks.real_recordings.cases import Case
from benchmarks.real_recordings.cube_tosses import HALF_WIDTH, ORIENTATION, POSITION
from benchmarks.real_recordings.errors import TOSS_STEPS
from benchmarks.real_recordings.methods import Prediction
from benchmarks.real_recordings.physics import simulate
from benchmarks.real_recordings.runs import Run

SECONDS = 0.5
"""Length of a window of the training part [s]."""

WINDOWS = 60
"""Number of windows of a pendulum's motion, drawn at random from all of the training part."""

TOSSES = 150
"""Number of tosses that are fitted, likewise: each is whole."""

EVERY = 5
"""Every fifth sample of a window is compared."""

SEED = 0

MAX_EVALUATIONS = 15
"""The fit ends after so many steps, taken or refused, if it has not converged before."""

BODY_RANGE = (0.7, 1.3)
"""Bounds of masses, centres of mass, lengths and the motors' gain, as shares of the authors' values."""

INERTIA_RANGE = (0.3, 5.0)
"""Bounds of a link's inertia, likewise."""

DAMPING_RANGE = (0.0, 50.0)
"""Bounds of viscous damping, likewise; some of the authors' are as good as nothing."""

FRICTION_RANGE = (0.0, 5.0)
"""Bounds of Coulomb friction, likewise."""

COULOMB_RANGE = (0.0, 1.0)
"""Bounds of Coulomb friction where the authors have none, as shares of COULOMB."""

COULOMB = 0.01
"""Coulomb friction of which shares are fitted where the authors have none [N·m]."""

PULL = 1e-3
"""Residual of a parameter that differs by its whole value from the authors', in units of SCALE."""

SCALE = {False: 0.01, True: 0.1}
"""Residuals are in units of this [rad; half widths of the cube], beyond which they count less: of pendulums, of cubes."""

SLOPE_STEP = 1e-4
"""Step of finite differences, as a share of the value; larger for cubes, whose motion is broken by contacts."""

CUBE_LENGTHS = (0.92, 1.08)
"""Bounds of a cube's lengths that are zero in its model, in half widths, from 1 on."""

CUBE_LENGTH_STEP = 0.003
"""Step of finite differences of such a length, likewise."""

TILTS = (0.98, 1.02)
"""Bounds of the board's tilt [rad], from 1 on."""

TILT_STEP = 6e-4
"""Step of finite differences of the tilt [rad]."""


@dataclass(frozen=True)
class Parameter:
    """A number of a model that is fitted, as a share of what the authors say."""

    name: str
    bounds: tuple[float, float]
    apply: Callable[[mujoco.MjModel, float], None]
    """Multiplies it in a fresh model."""
    start: float = 1.0
    slope_step: float = SLOPE_STEP


@dataclass(frozen=True)
class FittedPhysics:
    """A model with fitted parameters, and what the fit took."""

    model: mujoco.MjModel
    figures: dict[str, object]
    """Cells of the table."""


def fitted_physics(case: Case, training: list[Run]) -> Prediction:
    """Return what predicts by the model with fitted parameters."""
    fitted = fit_physics(case, training)

    def predict(
        starts: Float[np.ndarray, "W S"], controls: Float[np.ndarray, "W T C"]
    ) -> Float[np.ndarray, "W T+1 S"]:
        return simulate(fitted.model, starts, controls, case.dt)

    return Prediction(predict, fitted.figures)


def fit_physics(case: Case, training: list[Run]) -> FittedPhysics:
    """Return the model of a case with parameters fitted to the training part."""
    parameters = parameters_of(case)
    recorded, controls = _training_windows(case, training)
    names = [parameter.name for parameter in parameters]
    begin = np.array([parameter.start for parameter in parameters])
    rollouts = 0

    def residuals(shares: Float[np.ndarray, " P"]) -> Float[np.ndarray, " R"]:
        nonlocal rollouts
        rollouts += len(recorded)
        model = model_at(case, parameters, shares)
        if model.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4:
            model.opt.timestep = case.dt  # accurate to a millionth of a radian in a window
        predicted = simulate(model, recorded[:, 0], controls, case.dt)
        difference = _difference(case, recorded, predicted)[:, EVERY::EVERY].ravel()
        # A toss that ends before the window does has no rows there.
        known = np.where(np.isfinite(difference), difference, 0.0) / SCALE[case.is_cube]
        return np.append(known, PULL * (shares - begin) * np.sqrt(len(known)))

    bounds = np.array([parameter.bounds for parameter in parameters]).T
    steps = np.array([parameter.slope_step for parameter in parameters])
    # On a bound, the first finite difference could not be taken.
    inside = np.clip(begin, bounds[0] + 0.01, bounds[1] - 0.01)
    before = _cost(residuals(begin))
    found = least_squares(
        residuals,
        inside,
        bounds=(bounds[0], bounds[1]),
        loss="soft_l1",
        diff_step=steps,
        x_scale=steps / SLOPE_STEP,
        max_nfev=MAX_EVALUATIONS,
    )
    model = model_at(case, parameters, found.x)
    shares = dict(zip(names, found.x.tolist(), strict=True))
    at_bounds = [parameter.name for parameter in parameters if _is_at_bound(parameter, shares)]
    figures = {
        "iterations": found.njev,
        "rollouts": rollouts,
        "cost_before": before,
        "cost_after": float(found.cost / len(found.fun)),
        "fitted": " ".join(f"{name}={share:.4g}" for name, share in shares.items()),
        "at_bounds": " ".join(at_bounds),
    }
    return FittedPhysics(model, figures)


def _cost(residuals: Float[np.ndarray, " R"]) -> float:
    """Return the mean of SciPy's soft_l1 cost."""
    return float(np.mean(np.sqrt(1 + residuals**2) - 1))


def _is_at_bound(parameter: Parameter, shares: dict[str, float]) -> bool:
    low, high = parameter.bounds
    share = shares[parameter.name]
    near = 0.01 * (high - low)
    return share < low + near or share > high - near


def model_at(
    case: Case, parameters: list[Parameter], shares: Float[np.ndarray, " P"]
) -> mujoco.MjModel:
    """Return the case's model with each parameter multiplied by its share."""
    model = case.model_to_fit()
    for parameter, share in zip(parameters, shares, strict=True):
        parameter.apply(model, float(share))
    mujoco.mj_setConst(model, mujoco.MjData(model))
    return model


def parameters_of(case: Case) -> list[Parameter]:
    """Return what is fitted: of a chain each link and hinge, and the motors' gain; of the cube its contact and inertia."""
    if case.is_cube:
        return _cube_parameters()
    model = case.model()
    parameters = []
    for hinge in range(model.njnt):
        number = hinge + 1
        body = int(model.jnt_bodyid[hinge])
        parameters += [
            Parameter(f"mass{number}", BODY_RANGE, _mass(body)),
            Parameter(f"centre{number}", BODY_RANGE, _centre(body)),
            Parameter(f"inertia{number}", INERTIA_RANGE, _inertia(body)),
            Parameter(f"damping{number}", DAMPING_RANGE, _damping(hinge)),
        ]
        if hinge > 0:
            parameters.append(Parameter(f"length{hinge}", BODY_RANGE, _length(body)))
        if model.dof_frictionloss[hinge] > 0:
            parameters.append(Parameter(f"coulomb{number}", FRICTION_RANGE, _coulomb(hinge)))
        else:
            parameters.append(
                Parameter(f"coulomb{number}", COULOMB_RANGE, _new_coulomb(hinge), 0.0)
            )
        if case.columns.control:
            parameters.append(Parameter(f"gain{number}", BODY_RANGE, _gain(hinge)))
    return parameters


def _cube_parameters() -> list[Parameter]:
    """Return what is fitted of a cube; a step of finite differences moves it by about a millimetre in a toss."""
    return [
        Parameter("friction", (0.3, 3.0), _cube_friction, slope_step=0.05),
        Parameter("contact_time", (0.3, 3.0), _cube_time, slope_step=0.06),
        Parameter("damping", (0.1, 3.0), _cube_damping, slope_step=0.04),
        Parameter("inertia", BODY_RANGE, _inertia(1), slope_step=0.01),
        Parameter("half_width", (0.95, 1.05), _cube_half_width, slope_step=0.003),
        Parameter("rounding", (0.2, 3.0), _cube_rounding, slope_step=0.08),
        Parameter("gravity", (0.97, 1.03), _cube_gravity, slope_step=0.003),
        Parameter("board", CUBE_LENGTHS, _board_height, slope_step=CUBE_LENGTH_STEP),
        Parameter("centre_x", CUBE_LENGTHS, _cube_centre(0), slope_step=CUBE_LENGTH_STEP),
        Parameter("centre_y", CUBE_LENGTHS, _cube_centre(1), slope_step=CUBE_LENGTH_STEP),
        Parameter("centre_z", CUBE_LENGTHS, _cube_centre(2), slope_step=CUBE_LENGTH_STEP),
        Parameter("tilt_x", TILTS, _tilt(0), slope_step=TILT_STEP),
        Parameter("tilt_y", TILTS, _tilt(1), slope_step=TILT_STEP),
    ]


def _mass(body: int) -> Callable[[mujoco.MjModel, float], None]:
    def apply(model: mujoco.MjModel, share: float) -> None:
        model.body_mass[body] *= share

    return apply


def _centre(body: int) -> Callable[[mujoco.MjModel, float], None]:
    def apply(model: mujoco.MjModel, share: float) -> None:
        model.body_ipos[body] *= share

    return apply


def _inertia(body: int) -> Callable[[mujoco.MjModel, float], None]:
    def apply(model: mujoco.MjModel, share: float) -> None:
        model.body_inertia[body] *= share

    return apply


def _length(body: int) -> Callable[[mujoco.MjModel, float], None]:
    """Return what moves the next link's hinge along this link."""

    def apply(model: mujoco.MjModel, share: float) -> None:
        model.body_pos[body] *= share

    return apply


def _damping(hinge: int) -> Callable[[mujoco.MjModel, float], None]:
    def apply(model: mujoco.MjModel, share: float) -> None:
        model.dof_damping[hinge] *= share

    return apply


def _coulomb(hinge: int) -> Callable[[mujoco.MjModel, float], None]:
    def apply(model: mujoco.MjModel, share: float) -> None:
        model.dof_frictionloss[hinge] *= share

    return apply


def _new_coulomb(hinge: int) -> Callable[[mujoco.MjModel, float], None]:
    def apply(model: mujoco.MjModel, share: float) -> None:
        model.dof_frictionloss[hinge] = share * COULOMB

    return apply


def _gain(motor: int) -> Callable[[mujoco.MjModel, float], None]:
    def apply(model: mujoco.MjModel, share: float) -> None:
        model.actuator_gear[motor] *= share

    return apply


def _cube_friction(model: mujoco.MjModel, share: float) -> None:
    model.geom_friction[_corners(model), 0] *= share


def _cube_time(model: mujoco.MjModel, share: float) -> None:
    """Multiply the time constant of the contact: a large share is a soft contact."""
    model.geom_solref[_corners(model), 0] *= share


def _cube_damping(model: mujoco.MjModel, share: float) -> None:
    model.geom_solref[_corners(model), 1] *= share


def _cube_half_width(model: mujoco.MjModel, share: float) -> None:
    """Move the corners outwards; their radius stays."""
    corners = _corners(model)
    radius = model.geom_size[corners, :1]
    outwards = np.sign(model.geom_pos[corners])
    model.geom_pos[corners] = share * model.geom_pos[corners] + (share - 1) * radius * outwards


def _cube_rounding(model: mujoco.MjModel, share: float) -> None:
    """Multiply the radius of the corners; the half width stays."""
    corners = _corners(model)
    growth = (share - 1) * model.geom_size[corners, :1]
    model.geom_pos[corners] -= growth * np.sign(model.geom_pos[corners])
    model.geom_size[corners, 0] *= share
    model.geom_rbound[corners] *= share
    model.geom_aabb[corners] *= share


def _cube_gravity(model: mujoco.MjModel, share: float) -> None:
    model.opt.gravity[2] *= share


def _board_height(model: mujoco.MjModel, share: float) -> None:
    board = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_GEOM, "board")
    model.geom_pos[board, 2] = (share - 1) * HALF_WIDTH


def _cube_centre(axis: int) -> Callable[[mujoco.MjModel, float], None]:
    def apply(model: mujoco.MjModel, share: float) -> None:
        model.body_ipos[1, axis] = (share - 1) * HALF_WIDTH

    return apply


def _tilt(axis: int) -> Callable[[mujoco.MjModel, float], None]:
    """Return what tilts the board along an axis, by gravity that is turned the other way."""

    def apply(model: mujoco.MjModel, share: float) -> None:
        model.opt.gravity[axis] = (share - 1) * model.opt.gravity[2]

    return apply


def _corners(model: mujoco.MjModel) -> np.ndarray:
    return np.flatnonzero(model.geom_type == mujoco.mjtGeom.mjGEOM_SPHERE)


def _training_windows(
    case: Case, training: list[Run]
) -> tuple[Float[np.ndarray, "W T+1 S"], Float[np.ndarray, "W T C"]]:
    length = TOSS_STEPS if case.is_cube else round(SECONDS / case.dt)
    places = []
    for number, run in enumerate(training):
        last = len(run.states) - length
        starts = range(min(last, 1)) if case.is_cube else range(last)
        places += [(number, start) for start in starts]
    rng = np.random.default_rng(SEED)
    count = TOSSES if case.is_cube else WINDOWS
    chosen = rng.permutation(len(places))[:count]
    states = []
    controls = []
    for place in chosen:
        number, start = places[place]
        run = training[number]
        states.append(run.states[start : start + length + 1])
        controls.append(run.controls[start : start + length])
    return np.stack(states), np.stack(controls)


def _difference(
    case: Case, recorded: Float[np.ndarray, "W T S"], predicted: Float[np.ndarray, "W T S"]
) -> Float[np.ndarray, "W T D"]:
    """Return differences of angles [rad], or of a cube's positions (in half widths) and orientations (about radians)."""
    if case.is_cube:
        position = (predicted[..., POSITION] - recorded[..., POSITION]) / HALF_WIDTH
        first = recorded[..., ORIENTATION]
        second = predicted[..., ORIENTATION]
        sign = np.sign(np.sum(first * second, axis=-1, keepdims=True))
        return np.concatenate([position, 2 * (second - sign * first)], axis=-1)
    hinges = recorded.shape[2] // 2
    return predicted[..., :hinges] - recorded[..., :hinges]
