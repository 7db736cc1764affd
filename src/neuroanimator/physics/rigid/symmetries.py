"""The symmetries of a MuJoCo model: guessed from its bodies at the reference pose, kept if its physics has them."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from typing import TYPE_CHECKING

import mujoco
import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from neuroanimator.physics.rigid.actuators import actuators_of_controls, moment_arms
from neuroanimator.physics.rigid.bones import joint_kind, joints_of_body
from neuroanimator.physics.rigid.warnings import warnings_counted
from neuroanimator.state.symmetry import Symmetry

if TYPE_CHECKING:
    from neuroanimator.physics.rigid.mujoco_system import MujocoSystem

CLOSE = 3e-3
"""Relative tolerance, or absolute in metres, of the numbers of matching bodies."""

MAX_BODIES = 100
"""Maximum number of bodies: larger models, such as ropes and heaps, are skipped."""

MAX_TRIED = 64
"""Maximum number of pairings of a model's bodies tried: a heap of equal boxes has very many."""

MAX_COMPARED = 5000
"""Maximum number of pairs of bodies compared in a mirror: if many differ only far below, endless pairings fail."""

TRIED = 64
"""Approximate number of motions on which each symmetry is tested."""

MAX_KEPT = 8
"""Maximum number of symmetries kept."""

STEPS = 10
"""Number of physics steps after which motions are compared."""

MAX_DISCREPANCY = 0.03
"""Maximum rms difference of two motions that should be the same, over the states' usual change: far below the errors of
emulators of such bodies. Gymnasium's humanoid differs by nearly as much, as its left knee is stiffer than the right."""

SMALL_CHANGE = 1e-6
"""Minimum change by which differences are divided [rad, m, rad/s or m/s]."""

Pairing = dict[int, int]
"""Partner of each body or joint."""


def symmetries_of(
    system: MujocoSystem, states: Float[np.ndarray, "N S"], controls: Float[np.ndarray, "N C"]
) -> dict[Symmetry, float]:
    """Return the symmetries of `system` and the `discrepancy` of each, tested from some of `states` under `controls`.

    They are mirrors at the planes of the world's axes, half turns about them, and swaps of equal limbs, without the
    identity.
    """
    if system.sensors or system.external_forces or system.parameters:
        return {}
    some = slice(0, None, max(1, len(states) // TRIED))
    starts = states[some].astype(float)
    driven = controls[some].astype(float)
    kept: dict[Symmetry, float] = {}
    for symmetry in likely_symmetries(system.model):
        error = discrepancy(system, symmetry, starts, driven)
        if error <= MAX_DISCREPANCY:
            kept[symmetry] = error
        if len(kept) == MAX_KEPT:
            break
    return kept


def discrepancy(
    system: MujocoSystem,
    symmetry: Symmetry,
    states: Float[np.ndarray, "N S"],
    controls: Float[np.ndarray, "N C"],
) -> float:
    """Return the rms difference between motions under `symmetry` and those of the physics from their mirrored starts, over
    usual changes.

    Motions from the state of rest itself do not count: equal limbs may overlap there, and the order of the bodies
    decides which of them is pushed where.
    """
    dt = STEPS * system.physics_dt
    is_moved = (states != system.rest).any(axis=1)
    states = states[is_moved]
    controls = controls[is_moved]
    starts = np.concatenate([states, symmetry.state(states)])
    driven = np.concatenate([controls, symmetry.control(controls)])[:, None]
    runs = system.simulate(starts, driven, dt, scheme=system.scheme)
    ends, others = np.split(runs.states[:, -1], 2)
    is_whole = ~np.logical_or(*np.split(runs.has_diverged, 2))
    if not is_whole.any():
        return np.inf
    usual = np.maximum((ends - states)[is_whole].std(axis=0), SMALL_CHANGE)
    error = (others - symmetry.state(ends))[is_whole] / symmetry.state(usual)
    return float(np.sqrt(np.mean(error**2)))


def likely_symmetries(model: mujoco.MjModel) -> tuple[Symmetry, ...]:
    """Return the symmetries that masses, positions and joints of the bodies allow, ignoring friction, shapes and limits."""
    if model.nbody > MAX_BODIES:
        return ()
    data = mujoco.MjData(model)
    with warnings_counted:
        mujoco.mj_forward(model, data)
    found: dict[Symmetry, None] = {}
    for mirror in _mirrors(model):
        likeness = _Likeness(model, data, mirror)
        for bodies in itertools.islice(likeness.pairings(0, 0), MAX_TRIED):
            symmetry = likeness.symmetry(bodies)
            if symmetry is not None and not symmetry.is_identity:
                found[symmetry] = None
    return tuple(found)


def _mirrors(model: mujoco.MjModel) -> Iterator[Float[np.ndarray, " 3"]]:
    """Return the factors of X, Y and Z that leave gravity and wind unchanged."""
    fields = np.array([model.opt.gravity, model.opt.wind])
    for signs in itertools.product((1.0, -1.0), repeat=3):
        if np.array_equal(fields * signs, fields):
            yield np.array(signs)


class _Likeness:
    """The bodies of a model whose mirror images match others, at the reference pose."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, mirror: Float[np.ndarray, " 3"]):
        """Use `mirror`, the factors of X, Y and Z; `data` is at the reference pose, fully computed."""
        self.model = model
        self.data = data
        self.mirror = mirror
        self.turn = mirror * mirror.prod()
        """The same for angular velocities and the vector part of quaternions."""
        self.compared = 0
        """Number of pairs of bodies compared."""
        self.children: list[list[int]] = [[] for _ in range(model.nbody)]
        for body in range(1, model.nbody):
            self.children[model.body_parentid[body]].append(body)

    def pairings(self, body: int, other: int) -> Iterator[Pairing]:
        """Return every pairing of `body` and its descendants with `other` and its descendants."""
        if self._is_alike(body, other):
            for below in self._pairings_of(self.children[body], self.children[other]):
                yield {body: other} | below

    def _pairings_of(self, bodies: list[int], others: list[int]) -> Iterator[Pairing]:
        if len(bodies) != len(others):
            return
        if not bodies:
            yield {}
            return
        first, *rest = bodies
        for other in others:
            left = [body for body in others if body != other]
            for here in self.pairings(first, other):
                for there in self._pairings_of(rest, left):
                    yield here | there

    def _is_alike(self, body: int, other: int) -> bool:
        model = self.model
        data = self.data
        self.compared += 1
        if self.compared > MAX_COMPARED or model.body_jntnum[body] != model.body_jntnum[other]:
            return False
        if body == 0:
            return True
        return (
            _is_close(model.body_mass[body], model.body_mass[other])
            and _is_close(self.mirror * data.xipos[body], data.xipos[other])
            and _is_close(
                self._inertia(body) * np.outer(self.mirror, self.mirror), self._inertia(other)
            )
        )

    def _inertia(self, body: int) -> Float[np.ndarray, "3 3"]:
        axes = self.data.ximat[body].reshape(3, 3)
        return axes * self.model.body_inertia[body] @ axes.T

    def symmetry(self, bodies: Pairing) -> Symmetry | None:
        """Return the symmetry of states and controls by a pairing of bodies; None if their joints or actuators do not match."""
        model = self.model
        state = _Places(model.nq + model.nv + model.na)
        for body, other in bodies.items():
            for joint, joint_of_other in zip(
                joints_of_body(model, body), joints_of_body(model, other), strict=True
            ):
                if not self._pair_joints(state, joint, joint_of_other):
                    return None
        moments = moment_arms(model, self.data)
        velocities = slice(model.nq, model.nq + model.nv)
        rates = np.array(state.sources[velocities]) - model.nq
        mirrored = moments[:, rates] * state.signs[velocities]
        actuators = _Places(model.nactuator)
        for actuator in range(model.nactuator):
            if not _pair_actuators(model, actuators, actuator, mirrored, moments):
                return None
        controls = _Places(model.nu)
        first = model.nq + model.nv
        for actuator, source in enumerate(actuators.sources):
            sign = float(actuators.signs[actuator])
            place, other = model.actuator_ctrladr[[actuator, source]].tolist()
            controls.put(place, other, np.full(model.actuator_ctrlnum[actuator], sign))
            place, other = (first + model.actuator_actadr[[actuator, source]]).tolist()
            state.put(place, other, np.full(model.actuator_actnum[actuator], sign))
        if not (state.is_full and controls.is_full):
            return None
        return Symmetry(
            tuple(state.sources), tuple(state.signs), tuple(controls.sources), tuple(controls.signs)
        )

    def _pair_joints(self, state: _Places, joint: int, other: int) -> bool:
        """Let `other` move as the mirror image of `joint`; False if it cannot."""
        model = self.model
        kind = joint_kind(model, joint)
        if joint_kind(model, other) != kind:
            return False
        position, position_other = model.jnt_qposadr[[joint, other]].tolist()
        velocity, velocity_other = (model.nq + model.jnt_dofadr[[joint, other]]).tolist()
        if kind in ("hinge", "slide"):
            factors = self.turn if kind == "hinge" else self.mirror
            sign = _sign(factors * self.data.xaxis[joint], self.data.xaxis[other])
            reference = model.qpos0[position]
            if not sign or not _is_close(sign * reference, model.qpos0[position_other]):
                return False
            state.put(position_other, position, sign)
            state.put(velocity_other, velocity, sign)
            return True
        if not (self._is_level(joint) and self._is_level(other)):
            return False
        if kind == "free":
            state.put(position_other, position, self.mirror)
            state.put(velocity_other, velocity, self.mirror)
            position, position_other = position + 3, position_other + 3
            velocity, velocity_other = velocity + 3, velocity_other + 3
        state.put(position_other, position, [1, *self.turn])
        state.put(velocity_other, velocity, self.turn)
        return True

    def _is_level(self, joint: int) -> bool:
        """Return whether the axes of a ball's or free joint's body are the world's, so that a mirror only flips signs."""
        body = self.model.jnt_bodyid[joint]
        return _is_close(self.data.xmat[body].reshape(3, 3), np.eye(3))


class _Places:
    """A signed permutation of numbers, as far as it is known."""

    def __init__(self, size: int):
        """Begin with `size` empty places."""
        self.sources = [-1] * size
        self.signs = [1] * size

    @property
    def is_full(self) -> bool:
        """Whether every place is filled."""
        return -1 not in self.sources

    def put(self, place: int, source: int, signs: ArrayLike) -> None:
        """Move the number at `source`, times its sign, to `place`; neighbours, if there are several signs, beside it."""
        for offset, sign in enumerate(np.atleast_1d(signs)):
            self.sources[place + offset] = source + offset
            self.signs[place + offset] = int(sign)


def _pair_actuators(
    model: mujoco.MjModel,
    actuators: _Places,
    actuator: int,
    mirrored: Float[np.ndarray, "F V"],
    moments: Float[np.ndarray, "F V"],
) -> bool:
    """Pair `actuator` with a free one that has its `mirrored` moment; False if there is none, or if it has several forces."""
    if model.actuator_outnum[actuator] != 1:
        return False
    moment = mirrored[model.actuator_outadr[actuator]]
    for other in range(model.nactuator):
        sign = _sign(moment, moments[model.actuator_outadr[other]])
        if (
            actuators.sources[other] < 0
            and sign
            and _is_like_actuator(model, actuator, other, sign)
        ):
            actuators.put(other, actuator, sign)
            return True
    return False


def _is_like_actuator(model: mujoco.MjModel, actuator: int, other: int, sign: int) -> bool:
    """Return whether `other`, driven by `sign` times the control, is as strong as `actuator` and has the same bounds."""
    numbers = (
        model.actuator_gaintype,
        model.actuator_biastype,
        model.actuator_dyntype,
        model.actuator_ctrlspec,
        model.actuator_outnum,
        model.actuator_actnum,
        model.actuator_gainprm,
        model.actuator_biasprm,
        model.actuator_dynprm,
    )
    if not all(_is_close(number[actuator], number[other]) for number in numbers):
        return False
    owners = actuators_of_controls(model)
    bounds = np.sort(sign * model.actuator_ctrlrange[owners == actuator])
    return _is_close(bounds, model.actuator_ctrlrange[owners == other])


def _sign(one: Float[np.ndarray, " K"], other: Float[np.ndarray, " K"]) -> int:
    """Return 1 if two vectors are the same, -1 if they are opposite, 0 otherwise."""
    if _is_close(one, other):
        return 1
    return -1 if _is_close(-one, other) else 0


def _is_close(one: ArrayLike, other: ArrayLike) -> bool:
    return np.allclose(one, other, rtol=CLOSE, atol=CLOSE)
