"""A system made from a definition and a MuJoCo model: a shipped one or a user's."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import mujoco
import numpy as np
from jaxtyping import Bool, Float

from neuroanimator.definitions.model import Definition
from neuroanimator.definitions.parts import GoalTable
from neuroanimator.errors import ArgumentError, BadFileError
from neuroanimator.files.names import check_known, model_name
from neuroanimator.physics.rigid.actuators import bounds_of_controls, layout_of_controls
from neuroanimator.physics.rigid.bones import skeleton_of
from neuroanimator.physics.rigid.contacts import contacts_of
from neuroanimator.physics.rigid.equalities import close_states, open_equality, ways_between
from neuroanimator.physics.rigid.ground import height_entry, lift_out
from neuroanimator.physics.rigid.joints import (
    JointView,
    joint_views,
    sensor_numbers,
    state_layout,
    structure_of,
)
from neuroanimator.physics.rigid.limbs import groups_of
from neuroanimator.physics.rigid.model_parameters import Family
from neuroanimator.physics.rigid.mujoco_system import MujocoSystem
from neuroanimator.physics.rigid.rows import rows_at
from neuroanimator.physics.rigid.symmetries import symmetries_of
from neuroanimator.physics.rigid.warnings import warnings_counted
from neuroanimator.physics.schemes import schemes_of
from neuroanimator.state.parameters import nominal_values
from neuroanimator.state.rotation import facing, multiply, rotate, rotated_by
from neuroanimator.state.start import Start, start_state
from neuroanimator.state.symmetry import Symmetry
from neuroanimator.systems.goal import Goal, goal_in_layout
from neuroanimator.systems.system import System

HOME = "home"
"""Name of the keyframe that is the state of rest, if the model has one."""

MAX_REDRAWS = 20
"""Maximum number of times that states are drawn again which no step brings to the model's equalities."""

REST_SEED = 0
"""Seed of poses tried when the equalities cannot be satisfied from the pose of rest."""

TYPED = 0.01
"""Largest change of a start's numbers that is rounding: people type three digits [rad, m, rad/s or m/s]."""

Draw = Callable[[np.random.Generator, int], np.ndarray]
"""Function that returns a number of random states (count, S)."""


class ModelSystem(MujocoSystem):
    """A MuJoCo model, represented, driven and sampled by its definition."""

    def __init__(self, definition: Definition, model: mujoco.MjModel, definition_text: str = ""):
        """Make the system of a compiled `model`.

        `definition_text` is the text from which the system can be made again; empty for a shipped one. Raises
        ArgumentError, which names the table and the name at fault.
        """
        self.name = definition.name
        self.definition_text = definition_text
        self.model = model
        self.views = joint_views(model, dict(definition.state), definition.frame.planar)
        self.sensors = sensor_entries(model, definition.sensors)
        if definition.parameters:
            self.family = Family(model, definition.parameters)
            self.parameters = self.family.parameters
        self.state = state_layout(model, self.views, definition.sensors, self.parameters)
        self.control = layout_of_controls(model)
        self.bounds = bounds_of_controls(model, definition.control, definition.holding)
        structure = structure_of(
            model,
            self.views,
            definition.frame,
            self.control,
            self.state.size,
            len(self.parameters),
        )
        self.skeleton = skeleton_of(model)
        contacts = None
        if definition.frame.contacts:
            contacts = contacts_of(
                model, self.skeleton.bones, self.views, structure.rates, structure.segments
            )
        groups = groups_of(model, self.views, definition.groups)
        self.structure = replace(structure, groups=groups, contacts=contacts)
        self.scheme, self.truth, self.fine = schemes_of(definition.physics)
        self.is_tied = bool(model.eq_active0.any())
        self.rest = self._closed_rest(self._state_of(definition.keyframe))
        keyframes = [self._state_of(keyframe_name(model, number)) for number in range(model.nkey)]
        self.resets = np.array([self.rest, *keyframes])
        self.reset_share = definition.sampling.reset_share
        self.has_symmetries = definition.frame.symmetries
        self.sampling = definition.sampling
        self.warm_up = definition.sampling.warm_up
        self._check_sampling()
        self.goals = self.goals_of(definition.goals)

    def symmetries(
        self, states: Float[np.ndarray, "N S"], controls: Float[np.ndarray, "N C"]
    ) -> tuple[Symmetry, ...]:
        """Return the model's symmetries, if its definition declares any; see `symmetries_of`."""
        if not self.has_symmetries:
            return ()
        return tuple(symmetries_of(self, states, controls))

    def closed(
        self, states: Float[np.ndarray, "N S"]
    ) -> tuple[Float[np.ndarray, "N S"], Bool[np.ndarray, " N"]]:
        """Return (the states near `states` that satisfy the model's equalities, whether each was found)."""
        if not self.is_tied:
            return super().closed(states)
        closing = close_states(self.model_of, states)
        return self.with_sensors(closing.states), closing.is_closed

    def at(self, /, **values: float) -> System:
        """Return the body of this family with the given parameters; see `System.at`. At rest it satisfies its equalities."""
        fixed = super().at(**values)
        rest, is_closed = fixed.closed(fixed.rest[None])
        if not is_closed[0]:
            raise self._open_error(rest[0])
        fixed.rest = rest[0]
        return fixed

    def sample_starts(self, rng: np.random.Generator, count: int) -> Float[np.ndarray, "B S"]:
        """Return random starts: some near rest, the others spread by the sampling table."""
        return self._draw_closed(self._draw_spread, rng, count)

    def sample_resets(self, rng: np.random.Generator, count: int) -> Float[np.ndarray, "B S"]:
        """Return the state of rest and those of keyframes in random order, with `reset_noise`, as in Gymnasium's resets."""
        return self._draw_closed(self._draw_resets, rng, count)

    def _draw_closed(
        self, draw: Draw, rng: np.random.Generator, count: int
    ) -> Float[np.ndarray, "B S"]:
        """Return `count` states of `draw` that satisfy the model's equalities: those that cannot are drawn again."""
        states, is_closed = self.closed(draw(rng, count))
        for _ in range(MAX_REDRAWS):
            if is_closed.all():
                return states
            is_open = ~is_closed
            states[is_open], is_closed[is_open] = self.closed(draw(rng, int(is_open.sum())))
        raise self._open_error(states[~is_closed][0])

    def _draw_spread(self, rng: np.random.Generator, count: int) -> Float[np.ndarray, "B S"]:
        """Return states around rest, assembled as it is."""
        is_near_rest = rng.random(count) < self.sampling.rest_share
        spread = np.where(is_near_rest, self.sampling.rest_spread, 1.0)[:, None]
        starts = np.repeat(self.rest[None], count, axis=0)
        for view in self.views:
            self._scatter(view, starts, spread, rng)
        self.draw_bodies(rng, starts)
        if self.is_tied:
            starts = close_states(self.model_of, starts, self.rest).states
        if self.sampling.above_ground:
            lift_out(self.model, self._height_entry(), starts)
        return self.with_sensors(starts)

    def _draw_resets(self, rng: np.random.Generator, count: int) -> Float[np.ndarray, "B S"]:
        """Return rest or keyframes, with noise."""
        starts = self.resets[rng.integers(0, len(self.resets), count)]
        noise = self.sampling.reset_noise
        positions = starts[:, : self.model.nq]
        positions += rng.uniform(-noise, noise, positions.shape)
        for position in positions:
            mujoco.mj_normalizeQuat(self.model, position)
        velocities = starts[:, self.model.nq : self.model.nq + self.model.nv]
        velocities += noise * rng.normal(size=velocities.shape)
        self.draw_bodies(rng, starts)
        return self.with_sensors(starts)

    def _state_of(self, keyframe: str) -> Float[np.ndarray, " S"]:
        """Return the nominal body's state at `keyframe`, or at rest if it is empty; see `_rest`."""
        unread = np.zeros(len(self.sensors))
        parts = [_rest(self.model, keyframe), unread, nominal_values(self.parameters)]
        return self.with_sensors(np.concatenate(parts)[None])[0]

    def _closed_rest(self, rest: Float[np.ndarray, " S"]) -> Float[np.ndarray, " S"]:
        """Return the state of rest near `rest` that satisfies the model's equalities; BadFileError if there is none."""
        states, is_closed = self.closed(rest[None])
        if is_closed[0]:
            return states[0]
        tries = np.repeat(states, MAX_REDRAWS, axis=0)
        rng = np.random.default_rng(REST_SEED)
        for state in tries:  # from elsewhere: near a singular pose no step leads to the constraints
            noise = rng.normal(size=self.model.nv)
            mujoco.mj_integratePos(self.model, state[: self.model.nq], noise, 1.0)
        tries, is_closed = self.closed(tries)
        if not is_closed.any():
            raise self._open_error(states[0])
        return tries[is_closed][0]

    def _open_error(self, state: Float[np.ndarray, " S"]) -> BadFileError:
        """Return the error that names the equality which `state` violates most."""
        return BadFileError(
            f"{self.name}: {open_equality(self.model_of(state), state)}, whatever the joints do. Correct its "
            'anchor or its numbers, the joints\' ranges or the keyframe, or switch it off by active="false".'
        )

    def _height_entry(self) -> int:
        """Return the state entry of the root's height, of a free joint or of a vertical slide."""
        entry = height_entry(self.model)
        if entry is None:
            raise ArgumentError(
                "sampling.above_ground: wanted a root with a free joint or a vertical slide. Set it to false."
            )
        return entry

    def start_at(self, parts: Start) -> Float[np.ndarray, " S"]:
        """Return the start that `parts` describe, with its sensor readings.

        Where joints depend on each other, those that are not among the parts follow. Raises ArgumentError for parts that
        violate an equality of the model.
        """
        start = super().start_at(parts)[None]
        if self.is_tied:
            start = self._closed_start(start, parts)
        return self.with_sensors(start)[0]

    def _closed_start(
        self, start: Float[np.ndarray, "1 S"], parts: Start
    ) -> Float[np.ndarray, "1 S"]:
        """Return the `start` whose joints that are not among `parts` satisfy the model's equalities."""
        given = start_state(self.state, np.full(self.state.size, np.nan), parts)
        is_given = np.isfinite(given)
        positions, velocities = given[: self.model.nq], given[self.model.nq :][: self.model.nv]
        ways = ways_between([self.model], self.rest[None, : self.model.nq], positions[None])
        held = np.isfinite([ways[0], velocities])
        closing = close_states(self.model_of, start, self.rest, held)
        if closing.is_closed[0]:
            return closing.states
        # all parts given, in a few digits
        nearest = close_states(self.model_of, start)
        is_other = is_given & (np.abs(nearest.states - start)[0] > TYPED)
        if nearest.is_closed[0] and not is_other.any():
            return nearest.states
        possible = close_states(self.model_of, start, self.rest).states[0]
        numbers = []
        for entry in np.flatnonzero(is_given):
            name, _, unit = self.state.names[entry].partition(" ")
            numbers.append(f"{name} = {possible[entry]:.4g} {unit}")
        raise ArgumentError(
            f"start: {open_equality(self.model_of(start[0]), closing.states[0])}. Leave out parts that depend on others; "
            f"possible is {', '.join(numbers)}."
        )

    def with_sensors(self, states: Float[np.ndarray, "B S"]) -> Float[np.ndarray, "B S"]:
        """Return `states` with their sensor readings."""
        if not self.sensors:
            return states
        states = states.copy()
        data = mujoco.MjData(self.model)
        sensed = slice(self.physical_size, self.physical_size + len(self.sensors))
        with warnings_counted:
            for state in states:
                model = self.model_of(state)
                self.put(data, state)
                mujoco.mj_forward(model, data)
                state[sensed] = data.sensordata[list(self.sensors)]
        return states

    def _scatter(
        self, view: JointView, starts: np.ndarray, spread: np.ndarray, rng: np.random.Generator
    ) -> None:
        """Scatter one joint in `starts` (B, S), by the share `spread` (B, 1) of the sampling table."""
        sizes = np.array(self.sampling.velocity.get(view.name, ()))
        drawn = rng.normal(size=(len(starts), len(sizes))) * sizes * spread
        if view.kind == "free":
            self._scatter_free(view, starts, spread, drawn, rng)
            return
        width = self.sampling.position.get(view.name, 0.0)
        if view.kind == "ball":
            orientation = slice(view.position_entry, view.position_entry + 4)
            increment = rng.normal(size=(len(starts), 3)) * width * spread
            starts[:, orientation] = rotated_by(starts[:, orientation], increment)
        elif isinstance(width, tuple):
            # Near rest, each start is that share of the way from rest to the drawn position.
            offset = rng.uniform(*width, len(starts)) - self.rest[view.position_entry]
            starts[:, view.position_entry] += offset * spread[:, 0]
        else:
            offset = rng.uniform(-1, 1, len(starts)) * width
            starts[:, view.position_entry] += offset * spread[:, 0]
        starts[:, view.velocity_entry : view.velocity_entry + len(sizes)] = drawn

    def _scatter_free(
        self,
        view: JointView,
        starts: np.ndarray,
        spread: np.ndarray,
        drawn: np.ndarray,
        rng: np.random.Generator,
    ) -> None:
        """Scatter a free body, with the velocities `drawn` along its own axes.

        A root has any heading, some tilt and height. Other bodies are only turned and moved over the level plane, so that they
        keep their support.
        """
        count = len(starts)
        is_root = view.index == 0
        orientation = slice(view.position_entry + 3, view.position_entry + 7)
        # orientation
        heading = rng.uniform(-np.pi, np.pi, count)
        if is_root:
            # Tilted about the level axes alone: the heading is drawn separately.
            tilt = rng.normal(size=(count, 3)) * [1, 1, 0] * self.sampling.tilt * spread
            starts[:, orientation] = rotated_by(starts[:, orientation], tilt)
        else:
            heading *= spread[:, 0]
        starts[:, orientation] = multiply(facing(heading), starts[:, orientation])
        # position, along x and y only if the table gives a distance: for most bodies it does not matter
        width = self.sampling.position.get(view.name, 0.0)
        if width:
            level = slice(view.position_entry, view.position_entry + 2)
            starts[:, level] += rng.uniform(-1, 1, (count, 2)) * width * spread
        if is_root:
            height = rng.uniform(*self.sampling.height, count)
            starts[:, view.position_entry + 2] += height * spread[:, 0]
        # velocities
        if drawn.shape[1]:
            velocity = slice(view.velocity_entry, view.velocity_entry + 3)
            starts[:, velocity] = rotate(starts[:, orientation], drawn[:, :3])
            starts[:, velocity.stop : velocity.stop + 3] = drawn[:, 3:]

    def _check_sampling(self) -> None:
        """Refuse sampling of missing joints, and velocities of another size than the joint's."""
        sizes = {view.name: len(view.velocities) for view in self.views}
        kinds = {view.name: view.kind for view in self.views}
        if self.sampling.above_ground:
            self._height_entry()
        for table in ("position", "velocity"):
            check_known(getattr(self.sampling, table), sizes, "joint", f"sampling.{table}")
        for name, width in self.sampling.position.items():
            if isinstance(width, tuple):
                _check_ends(name, width, kinds[name])
        for name, velocity in self.sampling.velocity.items():
            if len(velocity) != sizes[name]:
                raise ArgumentError(
                    f"sampling.velocity.{name}: wanted {sizes[name]} numbers, got {len(velocity)}."
                )

    def goal(self, name: str, table: GoalTable) -> Goal:
        """Return the goal that `table` describes; ArgumentError names `name` and the part at fault."""
        at_site = self._at_site(name, table.site) if table.site else {}
        return goal_in_layout(self.state, name, table, at_site)

    def _at_site(self, name: str, site: str) -> dict[str, list[float]]:
        """Return the parts of the state with the root at rest at `site`, with the site's orientation."""
        sites = [self.model.site(i).name for i in range(self.model.nsite)]
        if self.views[0].kind != "free" or site not in sites:
            raise ArgumentError(
                f"goals.{name}.site: no site '{site}', or no free root. Sites: {', '.join(sites)}."
            )
        data = mujoco.MjData(self.model)
        mujoco.mj_kinematics(self.model, data)
        orientation = np.empty(4)
        mujoco.mju_mat2Quat(orientation, data.site(site).xmat)
        root = self.views[0].name
        return {
            f"{root}.position": data.site(site).xpos.tolist(),
            f"{root}.orientation": orientation.tolist(),
            f"{root}.velocity": [0.0, 0.0, 0.0],
            f"{root}.angular_velocity": [0.0, 0.0, 0.0],
        }


def sensor_entries(model: mujoco.MjModel, names: tuple[str, ...]) -> tuple[int, ...]:
    """Return the entries of MuJoCo's sensor data of the sensors called `names`."""
    entries: list[int] = []
    for sensor in sensor_numbers(model, names):
        rows = rows_at(model.sensor_adr[sensor], model.sensor_dim[sensor])
        entries += range(model.nsensordata)[rows]
    return tuple(entries)


def _check_ends(name: str, ends: tuple[float, float], kind: str) -> None:
    """Refuse invalid ends of a spread, or ends for a joint that cannot have them."""
    if kind not in ("hinge", "slide"):
        raise ArgumentError(
            f"sampling.position.{name}: wanted one number, as it is a {kind} joint; got two."
        )
    if not ends[0] <= ends[1]:
        raise ArgumentError(f"sampling.position.{name}: wanted [least, largest], got {list(ends)}.")


def keyframe_name(model: mujoco.MjModel, keyframe: int) -> str:
    """Return the name of a keyframe; `key_2` if it has none."""
    return model_name(model.key(keyframe).name, f"key_{keyframe}")


def _rest(model: mujoco.MjModel, keyframe: str) -> Float[np.ndarray, " P"]:
    """Return the keyframe of that name, with its velocities.

    Without a name it is the one called `home`, or the model's reference pose at zero velocity. Raises ArgumentError for
    a missing keyframe.
    """
    data = mujoco.MjData(model)
    names = [keyframe_name(model, i) for i in range(model.nkey)]
    if keyframe:
        check_known([keyframe], names, "keyframe", "keyframe")
    wanted = keyframe or HOME
    if wanted in names:
        mujoco.mj_resetDataKeyframe(model, data, names.index(wanted))
        mujoco.mj_normalizeQuat(model, data.qpos)
    return np.concatenate([data.qpos, data.qvel, data.act])
