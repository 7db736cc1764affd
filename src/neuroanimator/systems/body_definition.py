"""A deformable system written down: mass points, springs, muscles and faces by name.

    name = "jelly"
    kind = "mass-spring"

    [nodes]
    a = [0.0, 0.0, 0.1, 0.02]            # place [m] and mass [kg]

    [springs.edges]
    stiffness = 50.0                     # [N/m]
    damping = 0.2                        # [N·s/m]
    pairs = [["a", "b"], ["b", "c"]]

`systems/assets/fish.toml` shows every table.
"""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from neuroanimator.errors import ArgumentError
from neuroanimator.parsing.names import PartName, SystemName
from neuroanimator.systems.body import Body, Ground, Water
from neuroanimator.systems.body_checks import check_faces, check_muscles, check_nodes, check_springs, listed
from neuroanimator.systems.definition import GoalTable, Step
from neuroanimator.systems.gait import Gait
from neuroanimator.systems.skin import SkinTable
from neuroanimator.tables import Finite, Positive, Share, Table

Integrator = Literal["symplectic", "semi-implicit", "rk4"]
NotNegative = Annotated[float, Field(ge=0, le=1e9, allow_inf_nan=False)]
Pair = tuple[PartName, PartName]

MOST_NODES, MOST_SPRINGS = 300, 3000
"""A definition may come from a stranger, and costs grow with these."""


class BodyPhysics(Table):
    """How the physics is stepped; see `System.scheme`, `truth` and `fine`."""

    step: Step
    integrator: Integrator = "symplectic"
    truth_step: Step
    truth_integrator: Integrator = "rk4"
    fine_step: Step
    fine_integrator: Integrator = "rk4"


class SpringTable(Table):
    """Springs of one kind."""

    stiffness: Positive
    damping: NotNegative
    pairs: tuple[Pair, ...] = Field(min_length=1, max_length=MOST_SPRINGS)


class MuscleTable(Table):
    """Springs that shorten when told to; every control is one muscle from -1, longest, to 1, shortest."""

    shorten: Annotated[float, Field(gt=0, lt=0.9)]
    """Share of its length by which a muscle shortens or lengthens."""
    response: Annotated[float, Field(ge=0, le=10)] = 0.0
    """[s] Time constant with which it follows its control."""
    springs: dict[PartName, tuple[Pair, ...]] = Field(min_length=1, max_length=100)
    """Per control, the springs it shortens."""


class WaterTable(Table):
    """See `body.Water`."""

    push: NotNegative
    drag: NotNegative = 0.0
    buoyancy: Annotated[float, Field(ge=0, le=10)] = 1.0
    surface: Finite | None = None
    depth: Positive = 0.1
    righting: NotNegative = 0.0


class GroundTable(Table):
    """See `body.Ground`."""

    stiffness: Positive
    damping: NotNegative = 0.0
    friction: NotNegative = 0.5
    slip: Positive = 0.05


class GaitTable(Table):
    """See `gait.Gait`."""

    period: Positive
    controls: dict[PartName, tuple[Finite, Finite]]
    """Per control, amplitude and lag [rad]; others rest."""


class BodySampling(Table):
    """Random starts of training runs, around the state of rest."""

    rest_share: Share = 0.2
    """Share of starts at rest, where most motions begin."""
    warm_up: Annotated[float, Field(ge=0, le=60)] = 0.0
    """Starts are taken from this first stretch of random driving [s]."""
    speed: tuple[NotNegative, NotNegative, NotNegative] = (0.0, 0.0, 0.0)
    """Standard deviation of the speeds along the body's own axes [m/s]."""
    spin: NotNegative = 0.0
    """Standard deviation of each angular velocity [rad/s]."""
    tilt: Annotated[float, Field(ge=0, le=3.2)] = 0.0
    """Standard deviation of the tilt [rad], where weight is felt; without weight a body starts turned anyhow."""
    height: tuple[Finite, Finite] = (0.0, 0.0)
    """Least and largest height over its place at rest [m]."""
    strain: Annotated[float, Field(ge=0, le=0.5)] = 0.0
    """Standard deviation of a random stretch of the whole body along each of its axes."""


class BodyDefinition(Table):
    """A system whose physics is a mass-spring body's."""

    name: SystemName
    kind: Literal["mass-spring"]
    substeps: int = Field(50, ge=1, le=1000)
    physics: BodyPhysics
    nodes: dict[PartName, tuple[Finite, Finite, Finite, Finite]] = Field(min_length=2)
    """Place at rest [m] and mass [kg]; X forward, Z up."""
    rest_height: Finite = 0.0
    """[m] Added to the height of every node where the body is put at rest: a swimmer rests under the surface."""
    springs: dict[PartName, SpringTable] = Field(min_length=1, max_length=50)
    muscles: MuscleTable | None = None
    pushes: dict[PartName, tuple[Finite, Finite, Finite]] = Field({})
    """Per control, the force [N] on the whole body at control 1; for bodies without muscles."""
    faces: tuple[Annotated[tuple[PartName, ...], Field(min_length=3, max_length=4)], ...] = ()
    """Corners of the parts of the skin that push water, counterclockwise from outside."""
    mirror: dict[PartName, PartName] = Field({})
    """Per mass point or control on the left its partner on the right, if the body has such a mirror."""
    groups: dict[PartName, tuple[PartName, ...]] = Field({})
    """Segments of the body, each a list of mass points; every one belongs to exactly one."""
    water: WaterTable | None = None
    ground: GroundTable | None = None
    probes: Annotated[tuple[tuple[Finite, Finite, Finite], ...], Field(max_length=32)] = ()
    """Places [m] as in `nodes` whose height over ground or water's surface an emulator is shown."""
    gait: GaitTable | None = None
    skin: SkinTable | None = None
    """What is drawn; without it, a ball at every mass point."""
    sampling: BodySampling = BodySampling()
    goals: dict[SystemName, GoalTable] = Field({})


def body_of(definition: BodyDefinition) -> Body:
    """Return the body `definition` describes; ArgumentError names what is wrong with it."""
    check_nodes(definition, MOST_NODES)
    names = tuple(definition.nodes)
    numbers = np.array(list(definition.nodes.values()), float)
    rows = [(pair, table) for table in definition.springs.values() for pair in table.pairs]
    springs = np.array([_numbers(names, pair, "springs") for pair, _ in rows])
    check_springs(names, numbers[:, :3], springs, MOST_SPRINGS)
    muscles, pushes = _drives(definition, springs, names)
    check_muscles(names, springs, muscles)
    faces = np.array([_corners(names, face) for face in definition.faces], int).reshape(-1, 4)
    check_faces(definition.faces, numbers[:, :3], faces)
    return Body(
        names=names,
        places=numbers[:, :3],
        masses=numbers[:, 3],
        springs=springs,
        stiffness=np.array([table.stiffness for _, table in rows]),
        damping=np.array([table.damping for _, table in rows]),
        muscles=muscles,
        pushes=pushes,
        faces=faces,
        response=definition.muscles.response if definition.muscles else 0.0,
        water=Water(**definition.water.model_dump()) if definition.water else None,
        ground=Ground(**definition.ground.model_dump()) if definition.ground else None,
        rest_height=definition.rest_height,
    )


def group_numbers(definition: BodyDefinition) -> dict[str, tuple[int, ...]]:
    """Return the groups as numbers of mass points; refuse groups that miss or repeat one."""
    names = list(definition.nodes)
    seen: dict[str, str] = {}
    for group, members in definition.groups.items():
        for member in members:
            if member not in names:
                raise ArgumentError(f"groups.{group}: no node called '{member}'. Nodes: {listed(names)}.")
            if member in seen:
                raise ArgumentError(f"groups.{group}: node '{member}' is in '{seen[member]}' already. Leave it in one.")
            seen[member] = group
    missing = [name for name in names if name not in seen]
    if definition.groups and missing:
        raise ArgumentError(f"groups: in none of them: {listed(missing)}. Put each into exactly one.")
    return {group: tuple(names.index(m) for m in members) for group, members in definition.groups.items()}


def mirror_of(definition: BodyDefinition, kind: str) -> np.ndarray | None:
    """Return (K,) each node's or control's partner; None where the body has no mirror.

    `body_checks.check_mirror` says whether it is one.
    """
    if not definition.mirror:
        return None
    every = {"nodes": list(definition.nodes), "controls": control_names(definition)}
    both = dict(definition.mirror)
    for left, right in definition.mirror.items():
        for name, partner in ((left, right), (right, left)):
            if name not in every["nodes"] + every["controls"]:
                raise ArgumentError(f"mirror: no node or control called '{name}'. Nodes: {listed(every['nodes'])}.")
            if both.setdefault(name, partner) != partner:
                raise ArgumentError(f"mirror: '{name}' has two partners, '{both[name]}' and '{partner}'. Name one.")
    for name in every[kind]:
        if both.get(name, name) not in every[kind]:
            raise ArgumentError(
                f"mirror: '{name}' has a partner of another kind, '{both[name]}'. Pair a node with a node, a control "
                "with a control."
            )
    return np.array([every[kind].index(both.get(name, name)) for name in every[kind]])


def gait_of(definition: BodyDefinition) -> Gait | None:
    """Return the gait; ArgumentError if it drives a control that is not there."""
    table, names = definition.gait, control_names(definition)
    if table is None:
        return None
    for name in table.controls:
        if name not in names:
            raise ArgumentError(f"gait.controls: no control called '{name}'. Controls: {', '.join(names)}.")
    amplitudes, lags = zip(*(table.controls.get(name, (0.0, 0.0)) for name in names), strict=True)
    return Gait(table.period, amplitudes, lags)


def control_names(definition: BodyDefinition) -> list[str]:
    """Return the names of the controls in order."""
    return list(definition.muscles.springs if definition.muscles else definition.pushes)


def _numbers(names: tuple[str, ...], members: tuple[str, ...], key: str) -> list[int]:
    for member in members:
        if member not in names:
            raise ArgumentError(f"{key}: {list(members)}: no node called '{member}'. Nodes: {listed(names)}.")
    return [names.index(member) for member in members]


def _corners(names: tuple[str, ...], face: tuple[str, ...]) -> list[int]:
    corners = _numbers(names, face, "faces")
    return corners if len(corners) == 4 else [*corners, corners[0]]


def _drives(definition: BodyDefinition, springs: np.ndarray, names: tuple[str, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Return the shares by which contractions shorten springs (P, M), and pushes (3, C)."""
    table = definition.muscles
    if bool(table) == bool(definition.pushes):
        came = "both" if table else "neither"
        raise ArgumentError(
            f"muscles or pushes: wanted exactly one of the two tables to drive the body, came {came}. "
            f"{'Leave one out' if table else 'Add one'}."
        )
    if not table:
        return np.zeros((len(springs), 0)), np.array(list(definition.pushes.values()), float).T
    shorten = np.zeros((len(springs), len(table.springs)))
    spring_of = {frozenset(pair): number for number, pair in enumerate(springs.tolist())}
    for column, (name, pairs) in enumerate(table.springs.items()):
        if not pairs:
            raise ArgumentError(f"muscles.springs.{name}: wanted at least one spring, came none. Name some.")
        for pair in pairs:
            wanted = frozenset(_numbers(names, pair, f"muscles.springs.{name}"))
            if wanted not in spring_of:
                raise ArgumentError(
                    f"muscles.springs.{name}: no spring connects {list(pair)}. Add it under 'springs', or name another."
                )
            shorten[spring_of[wanted], column] = table.shorten
    return shorten, np.zeros((3, shorten.shape[1]))
