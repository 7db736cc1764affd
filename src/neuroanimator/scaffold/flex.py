"""Proposal for a MuJoCo model with a soft body, whose mocap bodies move: their motions are tried."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import mujoco
import numpy as np
from jaxtyping import Float

from neuroanimator.definitions.flex import FlexDefinition
from neuroanimator.errors import ArgumentError
from neuroanimator.files.tables import check_table
from neuroanimator.learn.data.config import SOFT_COUNT
from neuroanimator.physics.soft.flex_model import flex_body, mover_names, thicknesses, tied_bodies
from neuroanimator.physics.soft.flex_scene import FlexScene
from neuroanimator.physics.soft.soft_body import Points
from neuroanimator.physics.soft.soft_scene import Motion
from neuroanimator.scaffold.defaults import FINE_PARTS, rounded, usual_name
from neuroanimator.scaffold.proposal import Proposal
from neuroanimator.scaffold.soft import FREE_ROW, data_steps
from neuroanimator.scaffold.teacher import affordable_count, data_row, in_words
from neuroanimator.state.shape_contacts import FREE
from neuroanimator.terminal import phase

SUPER_STEP = 1 / 30
"""Longest super step [s], unless one step is longer."""

SPEED = 1.0
"""Largest speed of a mover that strikes, over the size of the body [1/s]."""

CARRYING = 0.5
"""The same for one that carries it."""

REACH = 0.15
"""Distance that a mover carrying the body wanders, over the size of the body."""

BEYOND = 0.2
"""Distance that a striking mover goes beyond the body's middle, over the size of the body."""

TRIAL = 4.0
"""Maximum time for the movers' way there, and for the way back, in a trial [s]."""

FAR = 100.0
"""Distance of a node, over the size of the body, at which the body has flown apart."""

PATIENCE = 8.0
"""Processor time after which a trial ends [s]."""

TIMED_RUNS = 4
"""Number of random paths of movers on which the physics is timed."""

TIMED_STEPS = 30
"""Number of super steps of each."""

HALVINGS = 2
"""Maximum number of times that steps, or speeds, are halved."""

SAFE_STEPS = 2
"""Shortest time constant of contacts that MuJoCo accepts, in steps."""

DEEP = 0.1
"""Depth of contacts, over the thickness of a geom, above which they should be harder, or movers slower."""

MIN_SEEN = 0.5
"""Minimum share of their way that movers must go in a trial for its contact depths to count."""

MAX_SHAPES = 64
"""Number of shapes proposed, if there are enough nodes."""

COMMENTS = {
    "model": "one flex, and mocap bodies that move",
    "substeps": "steps in a super step",
    "shapes": "amplitudes that describe the body; more are more accurate and slower. Computed when first needed",
    "physics": "Steps [s]: the model's own, the teacher's, and the reference's. The integrator is the model's.",
    "physics.contact_time": "MuJoCo's solref of contacts with movers, and of ties to them [s]; 0 is the model's own",
}
"""Comments on the values of the TOML file."""

AS_MODELLED = "As hard as the model says."

HARDENED = "Harder than the model says, by physics.contact_time."

MOVERS = (
    "Mocap bodies: a control is a velocity, at most `speed` [m/s]. They wander by about `reach` [m] while shapes are found.\n"
    "Contacts are all that MuJoCo {version} finds: in trial runs up to {count} with one geom, {depth:.1f} mm deep. {hardness}"
)
"""Title of the movers' table."""


class MoverTrial(NamedTuple):
    """Observations while movers went there and back."""

    has_diverged: bool
    contacts: int
    """Largest number of contacts with one geom."""
    depth: float
    """Depth of the deepest contact beyond that at rest [m]: a body carried by a geom lies inside it from the start."""
    share: float
    """Largest such depth over the geom's thickness."""
    cost: float
    """Processor time of a super step of it [s]."""
    seen_share: float
    """Share of the path covered before `PATIENCE` ended the trial."""


def propose_flex(path: Path, model: mujoco.MjModel, *, has_options: bool = False) -> Proposal:
    """Return a definition of the compiled `model` at `path`, which has a flex.

    Raises BadFileError for an unsupported model, ArgumentError if `has_options` (options of other models were given), or
    if the physics diverges.
    """
    if has_options:
        raise ArgumentError(
            f"{path.name} has a soft body, which starts at rest as modelled. Leave --keyframe, --base and --passive out."
        )
    step = float(model.opt.timestep)
    substeps = max(1, int(SUPER_STEP / step + 1e-6))
    body = flex_body(path.name, model)
    movers = {
        name: _mover(model, number, body.positions) for name, number in mover_names(model).items()
    }
    values: dict[str, Any] = {
        "name": usual_name(path),
        "kind": "flex",
        "model": path.name,
        "substeps": substeps,
        "shapes": min(MAX_SHAPES, len(body.axes)),
        "physics": {
            "step": step,
            "truth_step": step / 2,
            "fine_step": rounded(step / FINE_PARTS, 12),
        },
        "movers": movers,
    }
    with phase("simulating"):
        trial = _tried(values, path.name, model)
        while trial.has_diverged and values["physics"]["truth_step"] > step / 2**HALVINGS:
            values["physics"]["truth_step"] /= 2
            trial = _tried(values, path.name, model)
        if trial.has_diverged:
            raise ArgumentError(
                f"{path.name}: the soft body flies apart even in steps of {values['physics']['truth_step']:g} s. Give it "
                'less damping, a smaller timestep, softer material, or integrator="discrete" and solver="CG".'
            )
        if trial.share > DEEP or tied_bodies(model) - {0}:
            values["physics"]["contact_time"] = SAFE_STEPS * step
            trial = _tried(values, path.name, model)
        halvings = 0
        while trial.share > DEEP and halvings < HALVINGS:
            for mover in movers.values():
                mover["speed"] = [rounded(speed / 2, 6) for speed in mover["speed"]]
            trial = _tried(values, path.name, model)
            halvings += 1
    definition = check_table(values, path.name, FlexDefinition)
    scene = FlexScene(definition, path.name, model)
    is_free = scene.anchor == FREE
    with phase("timing the physics"):
        cost = _usual_cost(scene, definition)
    data_seconds = data_steps(is_free) * cost
    hardness = HARDENED if "contact_time" in values["physics"] else AS_MODELLED
    title = MOVERS.format(
        version=mujoco.mj_versionString(),
        count=trial.contacts,
        depth=1000 * trial.depth,
        hardness=hardness,
    )
    comments = COMMENTS | {"movers": title}
    names = list(definition.movers)
    parts = (*names, *(f"{name}_velocity" for name in names))
    warnings = tuple(_warnings(trial, data_seconds))
    told = [("soft body", _kind_and_size(model, body.positions))]
    if is_free:
        told.append(FREE_ROW)
    told += [
        ("movers", ", ".join(names)),
        ("contacts", f"up to {trial.contacts} with one geom, {1000 * trial.depth:.1f} mm deep"),
        ("physics", f"{1000 * cost:.1f} ms a super step of the teacher's"),
        data_row(SOFT_COUNT, data_seconds),
    ]
    return Proposal(definition, comments, parts, warnings, tuple(told), data_seconds)


def _warnings(trial: MoverTrial, data_seconds: float) -> Iterator[str]:
    """Yield warnings for the user, one line each; the data take `data_seconds` of a core [s]."""
    if trial.share > DEEP:
        yield (
            f"movers: nodes go {1000 * trial.depth:.0f} mm deep into a geom, however slow it is. Write thicker or "
            "rounder geoms, a softer body, or a smaller timestep."
        )
    if trial.seen_share < MIN_SEEN:
        yield (
            f"movers: a super step of the physics takes {1000 * trial.cost:.0f} ms, so the trial ended after "
            f"{trial.seen_share:.0%} of the movers' path. There may be more contacts, and deeper ones."
        )
    count = affordable_count(SOFT_COUNT, data_seconds)
    if count < SOFT_COUNT:
        yield (
            f'physics: data take about {in_words(data_seconds)}. Write solver="CG" into the model, a larger timestep '
            f'(integrator="discrete" allows it) or fewer nodes; or make less: neuroanimator generate --count {count}.'
        )


def _kind_and_size(model: mujoco.MjModel, nodes: Points) -> str:
    """Return the kind of the body, its number of nodes and its size."""
    kind = ("rope", "cloth", "solid")[int(model.flex_dim[0]) - 1]
    return f"{kind} of {len(nodes):,} nodes, {np.ptp(nodes, axis=0).max():g} m"


def _mover(model: mujoco.MjModel, body: int, nodes: Points) -> dict[str, Any]:
    """Return the table of a mocap body: it carries the soft body around, or wanders from its position to beyond it."""
    size = float(np.ptp(nodes, axis=0).max())
    if body in tied_bodies(model):
        speed = CARRYING * size
        reach = [REACH * size] * 3
    else:
        speed = SPEED * size
        away = np.abs(model.body_pos[body] - nodes.mean(axis=0))
        reach = (away + BEYOND * size).tolist()
    return {"speed": [rounded(speed, 3)] * 3, "reach": [rounded(far, 3) for far in reach]}


def _tried(values: dict[str, Any], name: str, model: mujoco.MjModel) -> MoverTrial:
    """Return the observations while every mover goes there and back, at its speed: through the body, or over its reach."""
    definition = check_table(values, name, FlexDefinition)
    scene = FlexScene(definition, name, model)
    path = _there_and_back(scene, definition.substeps * definition.physics.step)
    at_rest = scene.touching(scene.positions, path[0])
    seen = [at_rest]
    begun = time.process_time()
    for positions in _simulated(scene, definition, path, PATIENCE):
        if not (np.abs(positions - scene.positions) < FAR * scene.size).all():
            return MoverTrial(True, 0, 0.0, 0.0, 0.0, 0.0)
        seen.append(scene.touching(positions, path[len(seen)]))
    cost = (time.process_time() - begun) / (len(seen) - 1)
    contacts = max(int(one.contacts.max(initial=0)) for one in seen)
    depths = np.max([one.depths for one in seen], axis=0) - at_rest.depths
    shares = depths / thicknesses(scene.model)
    seen_share = (len(seen) - 1) / (len(path) - 1)
    depth = float(depths.max(initial=0.0))
    return MoverTrial(False, contacts, depth, float(shares.max(initial=0.0)), cost, seen_share)


def _usual_cost(scene: FlexScene, definition: FlexDefinition) -> float:
    """Return the processor time of a super step of the usual data [s]: mostly of few contacts, as movers wander."""
    dt = definition.substeps * definition.physics.step
    rng = np.random.default_rng(0)
    starts = np.repeat(scene.movers.rest[None], TIMED_RUNS, axis=0)
    rates = scene.random_paths(rng, starts, np.zeros_like(starts), TIMED_STEPS, dt)
    frames = 0
    begun = time.process_time()
    for path in starts[:, None] + np.cumsum(dt * rates, axis=1):
        for _ in _simulated(scene, definition, path, PATIENCE / (2 * TIMED_RUNS)):
            frames += 1
    return (time.process_time() - begun) / frames


def _simulated(
    scene: FlexScene, definition: FlexDefinition, path: Float[np.ndarray, "_ D"], patience: float
) -> Iterator[Points]:
    """Yield the positions of the nodes after each super step of the teacher's, until `patience` is spent [s]."""
    dt = definition.substeps * definition.physics.step
    steps = round(dt / definition.physics.truth_step)
    motion = Motion(scene.positions, np.zeros_like(scene.positions))
    begun = time.process_time()
    for frame in range(len(path) - 1):
        positions, velocities = scene.play(motion, path[frame : frame + 2], dt, steps)
        motion = Motion(positions[0], velocities[0])
        yield motion.positions
        if time.process_time() - begun > patience:
            return


def _there_and_back(scene: FlexScene, dt: float) -> Float[np.ndarray, "F D"]:
    """Return positions of the movers [m], which do not turn."""
    middle = scene.body.positions.mean(axis=0)
    ends = []
    movers = scene.movers
    for mover, body in zip(movers.tables, scene.bodies, strict=True):
        end = np.add(mover.position, mover.reach)
        if body not in tied_bodies(scene.model):
            away = middle - mover.position
            distance = float(np.linalg.norm(away))
            end = middle + away / max(distance, 1e-9) * BEYOND * scene.size
        ends.append(end)
    change = np.concatenate(ends) - movers.rest
    longest = float((np.abs(change) / movers.speed).max())
    frames = min(math.ceil(longest / dt), round(TRIAL / dt))
    shares = np.linspace(0, 1, frames + 1)
    shares = np.concatenate([shares, shares[-2::-1]])
    return movers.rest + shares[:, None] * change
