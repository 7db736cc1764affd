"""The emulator's gradient of a cost beside central differences of the physics with all nodes, and what limits it."""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int
from soft_control import lowest_corner

import neuroanimator as na
from large_bodies_cases.equal_error import Test, controls_of, known_states
from neuroanimator.control.descent.descend import evaluator_of, pose_problem
from neuroanimator.control.descent.parametrisation import EachStep, Parametrisation, Spline
from neuroanimator.control.objective.costs import NearNode
from neuroanimator.systems.soft.program import LANES
from neuroanimator.systems.soft.scene import Motion
from neuroanimator.systems.soft.soft_system import SoftSystem
from neuroanimator.terminal import progress_bar

STEPS = 15
"""Number of super steps after which the cost is taken: 0.5 s."""

KNOTS = 6
"""Number of knots of a control's spline."""

SHIFT = 0.02
"""Step of central differences over a control's largest rate."""

OTHER_SHIFT = 0.1
"""Another, so that it is seen whether the first matters."""

COMPARED = 3
"""Number of runs with both steps."""

AWAY = 0.2
"""Distance of the point that is to be reached from where the node ends [the body's size]."""

SEED = 2**31
"""Of the points."""

PATCH = 0.1
"""Radius of the patch around the watched node, at rest [the body's size]."""

NODE = "node"
PATCH_MEAN = "patch"
MEAN = "mean"


class Cosines(NamedTuple):
    """How gradients of one run agree with differences of the physics."""

    controls: float
    """Of the emulator's gradient by all controls."""
    knots: float
    """Of that by the knots of splines."""
    carried: float
    """Of the gradient by all controls of a body that keeps its shape, and goes and turns with what holds it."""
    controls_otherwise: float = np.nan
    """The same as `controls` with the other step of differences; of the first runs alone."""
    differences: float = np.nan
    """Of differences by the one step with those by the other."""
    projected: float = np.nan
    """Of differences of the physics' part that the shapes tell, at the end, with those of all nodes."""
    restarted: float = np.nan
    """Of differences of physics that starts every super step from what the shapes tell, with those of all nodes."""
    controls_restarted: float = np.nan
    """Of the emulator's gradient with differences of that physics, from which it could be learnt without an error."""


def top(system: SoftSystem) -> int:
    """Return the node in the middle of the top."""
    nodes = system.shapes.decode(system.rest)
    return int((nodes[:, 2] - np.hypot(nodes[:, 0], nodes[:, 1])).argmax())


WATCHED = {"cape": lowest_corner, "flag": lowest_corner, "jelly": top}
"""The node of each body whose place is a cost."""


def ends_of(
    test: Test, run: int, controls: Float[np.ndarray, "B T C"]
) -> Float[np.ndarray, "B N 3"]:
    """Return all nodes after `controls`, from where this run of the test starts, on the true physics [m]."""
    system = test.system
    positions, velocities = (np.asarray(part[..., run]) for part in test.start[:2])
    steps = system.truth.steps(test.dt)
    parameters = np.repeat(test.parameters[:, run, None], LANES, axis=-1)
    ends = []
    for first in range(0, len(controls), LANES):
        rows = np.arange(first, first + LANES).clip(max=len(controls) - 1)
        lanes = Motion(
            np.repeat(positions[..., None], LANES, axis=-1),
            np.repeat(velocities[..., None], LANES, axis=-1),
        ).recentred()
        path = paths_of(test, run, controls[rows])
        played, _ = system.scene.play(lanes, path, test.dt, steps, parameters)
        last = np.moveaxis(played[-1] + lanes.origin, -1, 0)
        ends.append(last[: len(controls) - first])
    return np.concatenate(ends).astype(float)


def paths_of(
    test: Test, run: int, controls: Float[np.ndarray, "B T C"]
) -> Float[np.ndarray, "F D B"]:
    """Return the movers' positions and headings under `controls`, from where this run of the test starts."""
    changes = test.dt * np.moveaxis(np.cumsum(controls, axis=1), 0, -1)
    start = np.repeat(test.paths[:1, :, run, None], len(controls), axis=-1)
    return np.concatenate([start, start + changes])


def projected(
    test: Test,
    run: int,
    controls: Float[np.ndarray, "B T C"],
    nodes: Float[np.ndarray, "B N 3"],
) -> Float[np.ndarray, "B N 3"]:
    """Return `nodes` after `controls` as the shapes tell them [m]."""
    system = test.system
    movers = paths_of(test, run, controls)[-1].T
    states = system.encode(nodes, np.zeros_like(nodes), movers, np.zeros_like(movers))
    return system.shapes.decode(states)


def restarted_ends(
    test: Test, run: int, controls: Float[np.ndarray, "B T C"]
) -> Float[np.ndarray, "B N 3"]:
    """Return all nodes after `controls`, on physics that starts every super step from nodes put together of the shapes [m]."""
    system = test.system
    states = np.repeat(known_states(test)[run][None], len(controls), axis=0)
    for step in range(controls.shape[1]):
        held = controls[:, step : step + 1].clip(system.bounds.low, system.bounds.high)
        states = system.simulate(states, held, test.dt).states[:, -1]
    return system.shapes.decode(states)


def gradient_columns(test: Test, emulator: na.Emulator, paths: int) -> dict[str, float]:
    """Return the columns of a row: medians and the least of the cosines of so many runs."""
    found: dict[str, list[Cosines]] = {NODE: [], PATCH_MEAN: [], MEAN: []}
    with progress_bar(f"{test.system.name}: gradients", paths) as bar:
        for run in range(paths):
            of_run = cosines_of(test, emulator, run)
            for what, cosines in of_run.items():
                found[what].append(cosines)
            bar.advance_to(run + 1)
    columns: dict[str, float] = {}
    for what, cosines in found.items():
        for name in Cosines._fields:
            values = [getattr(one, name) for one in cosines]
            columns[f"{what}_{name}_median"] = float(np.nanmedian(values))
            columns[f"{what}_{name}_least"] = float(np.nanmin(values))
    return columns


def cosines_of(test: Test, emulator: na.Emulator, run: int) -> dict[str, Cosines]:
    """Return the cosines of one run of the test, of the watched node, of the patch around it and of the mean of all nodes.

    The cost is the squared distance from a point of where the physics takes the node, `AWAY` in a random direction.
    """
    system = test.system
    state = known_states(test)[run]
    spline = Spline.of(STEPS, KNOTS, emulator.bounds)
    knots = spline.guess(controls_of(test)[run, :STEPS])
    each = EachStep.of(STEPS, emulator.bounds)
    controls = np.asarray(spline.controls(knots.astype(np.float32)), float)
    numbers = each.guess(controls)
    end = np.asarray(emulator.rollout(state, controls), float)[-1]
    places = observed(system, ends_of(test, run, controls[None]))
    ways = shifted(system, controls, SHIFT)
    ends = ends_of(test, run, ways)
    moved = moved_by_controls(system, ends, SHIFT)
    told = moved_by_controls(system, projected(test, run, ways, ends), SHIFT)
    anew = moved_by_controls(system, restarted_ends(test, run, ways), SHIFT)
    otherwise = None
    if run < COMPARED:
        others = ends_of(test, run, shifted(system, controls, OTHER_SHIFT))
        otherwise = moved_by_controls(system, others, OTHER_SHIFT)
    rng = np.random.default_rng([SEED, run])
    cosines = {}
    for what in places:
        direction = rng.normal(size=3)
        direction /= np.linalg.norm(direction)
        point = places[what][0] + AWAY * system.scene.size * direction
        term = near(system, what, point)
        by_each = slopes(emulator, term, each, state, numbers)
        by_knots = slopes(emulator, term, spline, state, knots)
        away = places[what][0] - point
        scale = each.half * (1 - np.tanh(numbers.reshape(STEPS, -1)) ** 2)
        by_physics = scale * (moved[what] @ away)
        through = np.asarray(spline.basis, float).T @ by_physics
        carried = scale * (carried_by_movers(system, term, end) @ away)
        cosines[what] = Cosines(
            controls=cosine(by_each, by_physics),
            knots=cosine(by_knots, through),
            carried=cosine(carried, by_physics),
            projected=cosine(scale * (told[what] @ away), by_physics),
            restarted=cosine(scale * (anew[what] @ away), by_physics),
            controls_restarted=cosine(by_each, scale * (anew[what] @ away)),
        )
        if otherwise is not None:
            by_other = scale * (otherwise[what] @ away)
            cosines[what] = cosines[what]._replace(
                controls_otherwise=cosine(by_each, by_other),
                differences=cosine(by_physics, by_other),
            )
    return cosines


def near(system: SoftSystem, what: str, point: Float[np.ndarray, " 3"]) -> NearNode:
    """Return the cost of the watched node's, or of the mean of some nodes', not being at `point` [m] at the end."""
    shapes = system.shapes
    term = na.reach_node(system, WATCHED[system.name](system), point, within=system.scene.size)
    if what == NODE:
        return term
    nodes = averaged(system)[what]
    return NearNode(
        weight=term.weight,
        when=term.when,
        wanted=term.wanted,
        within=term.within,
        place=jnp.asarray(shapes.mean[nodes].mean(axis=0), jnp.float32),
        modes=jnp.asarray(shapes.modes[:, nodes].mean(axis=1), jnp.float32),
        first=term.first,
        placement=term.placement,
        axes=term.axes,
    )


def slopes(
    emulator: na.Emulator,
    term: NearNode,
    parametrisation: Parametrisation,
    state: Float[np.ndarray, " S"],
    numbers: Float[np.ndarray, " Z"],
) -> Float[np.ndarray, " Z"]:
    """Return the gradient as a descent through the emulator has it."""
    problem = pose_problem(emulator, na.Objective.of(term), parametrisation, state)
    _, gradients = evaluator_of(problem).gradients(numbers[None])
    return gradients[0]


def observed(
    system: SoftSystem, nodes: Float[np.ndarray, "B N 3"]
) -> dict[str, Float[np.ndarray, "B 3"]]:
    """Return where the watched node, the middle of the patch around it, and that of all nodes are [m]."""
    return {what: nodes[:, some].mean(axis=1) for what, some in averaged(system).items()}


def averaged(system: SoftSystem) -> dict[str, Int[np.ndarray, " _"]]:
    """Return the nodes over whose positions the mean is taken."""
    watched = WATCHED[system.name](system)
    at_rest = system.shapes.decode(system.rest)
    away = np.linalg.norm(at_rest - at_rest[watched], axis=1)
    return {
        NODE: np.array([watched]),
        PATCH_MEAN: np.flatnonzero(away <= PATCH * system.scene.size),
        MEAN: np.arange(len(at_rest)),
    }


def shifted(
    system: SoftSystem, controls: Float[np.ndarray, "T C"], shift: float
) -> Float[np.ndarray, "B T C"]:
    """Return `controls` with each number in turn a step higher, then with each a step lower."""
    steps = np.diag(np.tile(shift * system.bounds.magnitude, len(controls)))
    shifts = steps.reshape(-1, *controls.shape)
    return np.concatenate([controls + shifts, controls - shifts])


def moved_by_controls(
    system: SoftSystem, ends: Float[np.ndarray, "B N 3"], shift: float
) -> dict[str, Float[np.ndarray, "T C 3"]]:
    """Return by how much each control moves what is observed [m by m/s or rad/s], of all nodes after those `shifted`."""
    sizes = np.tile(shift * system.bounds.magnitude, STEPS)
    moved = {}
    for what, places in observed(system, ends).items():
        above, below = np.split(places, 2)
        change = (above - below) / (2 * sizes[:, None])
        moved[what] = change.reshape(STEPS, system.control.size, 3)
    return moved


def carried_by_movers(
    system: SoftSystem, term: NearNode, state: Float[np.ndarray, " S"]
) -> Float[np.ndarray, "D 3"]:
    """Return by how much each position and heading of movers moves what `term` observes of a body that keeps its shape."""
    count = system.control.size
    shift = 1e-4
    shifts = shift * np.eye(count, len(state))
    return np.asarray(term.observe(state + shifts) - term.observe(state - shifts)) / (2 * shift)


def cosine(first: Float[np.ndarray, " ..."], second: Float[np.ndarray, " ..."]) -> float:
    """Return the cosine between two gradients; 0 if one is nothing."""
    lengths = np.linalg.norm(first) * np.linalg.norm(second)
    return float(first.ravel() @ second.ravel() / lengths) if lengths else 0.0
