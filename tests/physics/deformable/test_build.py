"""Deformable bodies that cannot be simulated are refused in one line that says what is wrong and what to do."""

from __future__ import annotations

import copy
from collections.abc import Callable
from itertools import combinations, pairwise
from typing import Any

import numpy as np
import pytest

from neuroanimator.definitions.body import MAX_NODES, MAX_SPRINGS, BodyDefinition
from neuroanimator.errors import ArgumentError
from neuroanimator.files.tables import check_table
from neuroanimator.physics.deformable.build import group_numbers
from neuroanimator.physics.deformable.checks import largest_stable_step
from neuroanimator.physics.deformable.deformable_system import DeformableSystem

NODES = {
    "nose": [0.2, 0.0, 0.0, 0.1],
    "left": [0.0, 0.1, 0.0, 0.2],
    "right": [0.0, -0.1, 0.0, 0.2],
    "top": [0.0, 0.0, 0.1, 0.1],
    "tail": [-0.2, 0.0, 0.0, 0.1],
}
JELLY: dict[str, Any] = {
    "name": "jelly",
    "kind": "mass-spring",
    "physics": {"step": 0.002, "truth_step": 0.002, "fine_step": 0.0002},
    "nodes": NODES,
    "springs": {"all": {"stiffness": 50.0, "damping": 0.1, "pairs": [list(pair) for pair in combinations(NODES, 2)]}},
    "muscles": {
        "shorten": 0.2,
        "springs": {"pull_left": [["nose", "left"]], "pull_right": [["nose", "right"]], "lift": [["nose", "top"]]},
    },
    "faces": [
        ["nose", "left", "top"], ["nose", "top", "right"], ["top", "left", "tail"], ["tail", "right", "top"],
        ["nose", "tail", "left"], ["nose", "right", "tail"],
    ],
    "mirror": {"left": "right", "pull_left": "pull_right"},
    "groups": {"front": ["nose", "left", "right"], "back": ["top", "tail"]},
    "water": {"face_drag": 100.0},
}  # fmt: skip
SOFT = {"stiffness": 50.0, "damping": 0.1}


def make(change: Callable[[Any], object] = lambda jelly: None) -> DeformableSystem:
    """Return the jelly after `change` has had its way with the definition."""
    jelly = copy.deepcopy(JELLY)
    change(jelly)
    return DeformableSystem(check_table(jelly, "jelly.toml", BodyDefinition))


def put(value: Any, *path: Any) -> Callable[[Any], None]:
    """Return a change that puts `value` at a path of keys."""

    def change(table: Any) -> None:
        for key in path[:-1]:
            table = table[key]
        table[path[-1]] = value

    return change


def both(*changes: Callable[[Any], object]) -> Callable[[Any], None]:
    def change(jelly: Any) -> None:
        for each in changes:
            each(jelly)

    return change


def many_nodes(jelly: Any) -> None:
    jelly["nodes"] |= {f"n{i}": [0.01 * i, 0.0, 1.0, 0.1] for i in range(MAX_NODES)}


def many_springs(jelly: Any) -> None:
    names = [f"n{i}" for i in range(90)]
    jelly["nodes"] |= {name: [0.01 * i, 0.0, 1.0, 0.1] for i, name in enumerate(names)}
    pairs = [list(pair) for pair in combinations(names, 2)]
    jelly["springs"] |= {"more": {**SOFT, "pairs": pairs[:MAX_SPRINGS]}}


def another_piece(jelly: Any) -> None:
    jelly["nodes"] |= {"egg": [1.0, 0.0, 0.0, 0.1], "shell": [1.1, 0.0, 0.0, 0.1]}
    jelly["springs"]["egg"] = {**SOFT, "pairs": [["egg", "shell"]]}


def split_springs(**right: float) -> Callable[[Any], None]:
    """Return a change that gives the spring from nose to right numbers of its own."""

    def change(jelly: Any) -> None:
        jelly["springs"]["all"]["pairs"].remove(["nose", "right"])
        jelly["springs"]["right"] = {**SOFT, **right, "pairs": [["nose", "right"]]}

    return change


def pushed(**external_forces: list[float]) -> Callable[[Any], None]:
    def change(jelly: Any) -> None:
        del jelly["muscles"], jelly["mirror"]["pull_left"]
        jelly["external_forces"] = external_forces

    return change


def drop(*path: Any) -> Callable[[Any], None]:
    def change(table: Any) -> None:
        for key in path[:-1]:
            table = table[key]
        del table[path[-1]]

    return change


def test_the_body_itself_is_accepted_and_its_mirror_found():
    system = make()
    assert system.structure.mirror is not None
    assert system.structure.mirror.points == (0, 2, 1, 3, 4)
    assert system.structure.mirror.controls == (1, 0, 2)
    definition = check_table(JELLY, "jelly.toml", BodyDefinition)
    assert group_numbers(definition) == {"front": (0, 1, 2), "back": (3, 4)}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            put(["nose", "tial"], "springs", "all", "pairs", 0),
            r"springs: .* no node called 'tial'. Did you mean tail\? Nodes: nose, left",
        ),
        (put(0.0, "nodes", "top", 3), "nodes.top: wanted .* above 0 kg, got 0 kg"),
        (put(-1.0, "nodes", "top", 3), "nodes.top: .* got -1 kg"),
        (put(float("nan"), "nodes", "top", 3), "nodes.top"),
        (many_nodes, f"nodes: wanted at most {MAX_NODES}, got {MAX_NODES + 5}"),
        (many_springs, f"springs: wanted at most {MAX_SPRINGS}, got {MAX_SPRINGS + 10}"),
        (
            put([0.2, 0.0, 0.0, 0.1], "nodes", "top"),
            r"springs: \['nose', 'top'\] has no length at rest",
        ),
        (put(["nose", "nose"], "springs", "all", "pairs", 0), "no length at rest"),
        (
            put(["right", "nose"], "springs", "all", "pairs", 0),
            r"springs: \['nose', 'right'\] is there twice",
        ),
        (another_piece, "the body is in 2 pieces; no spring connects egg, shell to the rest"),
    ],
)
def test_nodes_and_springs_that_make_no_body_are_refused(
    change: Callable[[Any], None], message: str
):
    with pytest.raises(ArgumentError, match=message) as caught:
        make(change)
    assert len(str(caught.value).splitlines()) == 1


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            put([["left", "tail"], ["nose", "fin"]], "muscles", "springs", "lift"),
            "muscles.springs.lift: .* 'fin'",
        ),
        (
            put([], "muscles", "springs", "lift"),
            "muscles.springs.lift: wanted at least one spring, got none",
        ),
        (
            both(
                drop("springs", "all", "pairs", 2),
                put([["nose", "top"]], "muscles", "springs", "lift"),
            ),
            r"muscles.springs.lift: no spring connects \['nose', 'top'\]",
        ),
        (
            both(
                put(0.5, "muscles", "shorten"),
                put([["nose", "left"]], "muscles", "springs", "lift"),
            ),
            "muscles.shorten: .*'nose', 'left'.* by 1 of its length; wanted at most 0.9",
        ),
        (
            put({"along": [1.0, 0.0, 0.0]}, "external_forces"),
            "muscles or external_forces: wanted exactly one .*, got both",
        ),
        (drop("muscles"), "muscles or external_forces: .*, got neither"),
        (put(["nose", "left"], "groups", "front"), "groups: right belong to no group"),
        (
            put(["top", "tail", "nose"], "groups", "back"),
            "groups.back: node 'nose' is in 'front' already",
        ),
        (put(["top", "tial"], "groups", "back"), "groups.back: no node called 'tial'"),
        (
            put(["nose", "top", "left"], "faces", 0),
            r"faces: \['nose', 'top', 'left'\] and .* face opposite sides",
        ),
        (put([["nose", "top", "left"]], "faces"), r"faces: \['nose', 'top', 'left'\] looks inward"),
        (put(["nose", "tail", "nose"], "faces", 0), "faces: .* has no area"),
        (put(["nose", "fin", "top"], "faces", 0), "faces: .* no node called 'fin'"),
    ],
)
def test_muscles_groups_and_faces_that_make_no_sense_are_refused(
    change: Callable[[Any], None], message: str
):
    with pytest.raises(ArgumentError, match=message):
        make(change)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            put({"left": "pull_right"}, "mirror"),
            "mirror: 'left' has a partner of another kind, 'pull_right'",
        ),
        (put("rihgt", "mirror", "left"), "mirror: no node or control called 'rihgt'"),
        (put("right", "mirror", "top"), "mirror: 'right' has two partners, 'left' and 'top'"),
        (drop("mirror", "left"), "mirror: node left: .* needs .*, got .*position"),
        (
            put([0.0, -0.11, 0.0, 0.2], "nodes", "right"),
            "mirror: node (left|right): .* needs .*, got .*position",
        ),
        (
            put([0.0, -0.1 - 1e-8, 0.0, 0.2], "nodes", "right"),
            "mirror: node (left|right): .* needs .*, got .*position",
        ),
        (
            put([0.0, 1e-3, 0.1, 0.1], "nodes", "top"),
            "mirror: node top: .* needs .*, got .*position",
        ),
        (
            put(0.21, "nodes", "right", 3),
            "mirror: node right: .* 0.2\\], got .* 0.21\\].*mass",
        ),
        (
            drop("springs", "all", "pairs", 5),
            "mirror: spring left to top: .*, got none",
        ),
        (split_springs(stiffness=51.0), "mirror: spring .* needs \\[50.0, .* got \\[51.0"),
        (split_springs(damping=0.2), "mirror: spring .* needs \\[50.0, 0.1, .* got \\[50.0, 0.2"),
        (drop("mirror", "pull_left"), "mirror: spring .* share by which each muscle"),
        (
            put([["left", "top"]], "muscles", "springs", "pull_left"),
            "mirror: spring .* share by which each muscle",
        ),
        (
            put([["left", "tail"]], "muscles", "springs", "lift"),
            "mirror: spring .* share by which each muscle",
        ),
        (drop("faces", 0), r"mirror: a face is missing: \['left', 'top', 'nose'\]"),
        (
            pushed(along=[1.0, 0.0, 0.0], aside=[0.0, 1.0, 0.0]),
            "mirror: external force aside: .* needs",
        ),
    ],
)
def test_a_mirror_that_is_not_exact_is_refused(change: Callable[[Any], None], message: str):
    with pytest.raises(ArgumentError, match=message):
        make(change)


def bend(jelly: Any) -> None:
    """Make the jelly a ring with a gap: many of its faces look towards its centre."""
    rings = [[f"{side}{i}" for side in "abcd"] for i in range(7)]
    jelly["nodes"] = {
        f"{side}{i}": [np.cos(angle) * reach, y, np.sin(angle) * reach, 0.1]
        for i, angle in enumerate(np.linspace(0.0, 4.5, 7))
        for side, reach, y in (("a", 1.0, -0.1), ("b", 1.0, 0.1), ("c", 1.2, 0.1), ("d", 1.2, -0.1))
    }
    pairs = {
        pair for one, other in pairwise(rings) for pair in combinations(sorted(one + other), 2)
    }
    jelly["springs"]["all"]["pairs"] = sorted(pairs)
    jelly["faces"] = [
        [one[j], other[j], other[(j + 1) % 4], one[(j + 1) % 4]]
        for one, other in pairwise(rings)
        for j in range(4)
    ]
    jelly["muscles"]["springs"] = {"bend": [["a0", "a1"]]}
    jelly["mirror"], jelly["groups"] = {}, {}


def turn_faces(*numbers: int) -> Callable[[Any], None]:
    def change(jelly: Any) -> None:
        jelly["faces"] = [
            face[::-1] if i in numbers else face for i, face in enumerate(jelly["faces"])
        ]

    return change


def test_faces_of_a_bent_body_may_look_at_its_centre_and_fins_anywhere():
    make(bend)
    make(both(bend, lambda jelly: jelly["faces"].extend([["a0", "c0", "c1"], ["c1", "c0", "a0"]])))


def test_the_inverted_faces_of_a_bent_body_are_found():
    with pytest.raises(ArgumentError, match=r"\['b3', 'b4', 'a4', 'a3'\].* opposite sides"):
        make(both(bend, turn_faces(12)))
    with pytest.raises(ArgumentError, match=r"\['d3', 'd4', 'c4', 'c3'\].* opposite sides"):
        make(both(bend, turn_faces(14)))
    with pytest.raises(ArgumentError, match="looks inward"):
        make(both(bend, turn_faces(*range(24))))


@pytest.mark.parametrize("key", ["step", "truth_step", "fine_step"])
@pytest.mark.parametrize(
    ("integrator", "room"), [("symplectic", 1.0), ("semi-implicit", 1.0), ("rk4", 1.3)]
)
def test_a_step_at_which_small_vibrations_grow_is_refused(key: str, integrator: str, room: float):
    limit = largest_stable_step(make().body) * room
    scheme = put(integrator, "physics", key.replace("step", "integrator"))
    make(both(scheme, put(0.99 * limit, "physics", key)))
    with pytest.raises(
        ArgumentError, match=f"physics.{key}: .* {integrator} needs at most .* smaller step"
    ):
        make(both(scheme, put(1.01 * limit, "physics", key)))
