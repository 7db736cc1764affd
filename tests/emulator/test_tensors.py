"""The names that files give to arrays are those of the table in docs/format.md."""

from __future__ import annotations

import re
from collections.abc import Iterable
from functools import cache
from pathlib import Path

import jax
import pytest

from neuroanimator import Emulator, load_emulator, load_policy
from neuroanimator.emulator.networks import NETWORKS, make_network
from neuroanimator.emulator.networks.hierarchy import Hierarchy
from neuroanimator.emulator.networks.network import Network, Part
from neuroanimator.emulator.tensors import emulator_tensors

FORMAT = Path(__file__).parents[2] / "docs" / "format.md"
PARTS = (
    Part("body", (0, 1), (0,), (0, 1), ()),
    Part("left", (0, 2), (1,), (2,), (0,)),
    Part("right", (1, 2), (1,), (3,), (1,), like=0),
)


@cache
def documented() -> dict[str, set[str]]:
    """Return, by what the table says they are of, the documented names of tensors."""
    table = FORMAT.read_text().split("### Names of tensors")[1].split("## Policies")[0]
    names: dict[str, set[str]] = {}
    for row in table.splitlines():
        if not row.startswith("| `"):
            continue
        cells = row.split("|")
        for owner in cells[3].split(","):
            names.setdefault(owner.strip(), set()).update(re.findall("`(.+?)`", cells[1]))
    return names


def network_names(network: Network) -> set[str]:
    """Return the documented names of a network's tensors, those of a hierarchy's networks in their places."""
    kind = next(kind for kind, made in NETWORKS.items() if made is type(network))
    names = documented()[kind]
    if not isinstance(network, Hierarchy):
        return names
    upper = {name.removeprefix("network.") for name in network_names(network.upper)}
    children = {name.removeprefix("network.") for name in network_names(network.children)}
    assert names == {"network.upper.<name>", "network.children.<name>"}
    return {f"network.upper.{name}" for name in upper} | {
        f"network.children.{name}" for name in children
    }


def without_numbers(names: Iterable[str]) -> set[str]:
    """Return the names as the table writes them: `<i>` for the number of a layer."""
    return {re.sub(r"layer\d+", "layer<i>", name) for name in names}


def expected_names(emulator: Emulator) -> set[str]:
    expected = documented()["all"] | network_names(emulator.network)
    if not emulator.encoding.is_identity:
        expected |= documented()["deformable bodies"]
    if emulator.meter is not None:
        expected |= documented()["trust"]
    if emulator.calibration is not None:
        expected |= documented()["error bounds"]
    if emulator.validation is not None:
        expected |= documented()["validation"]
    return expected


@pytest.mark.parametrize("kind", sorted(NETWORKS))
def test_the_tensors_of_a_network_are_those_of_the_table(kind: str):
    widths = {"classic": (6,), "hierarchy": (6, 0, 4)}.get(kind, (6, 4))
    parts = PARTS if kind == "hierarchy" else ()
    even_out = (0, 3) if kind == "mirrored" else ()
    key = jax.random.key(0)
    network = make_network(kind, 3, 2, 4, widths, key, even_out=even_out, parts=parts)
    names = {f"network.{name}" for name in network.leaves()}
    assert without_numbers(names) == network_names(network)


@pytest.mark.parametrize("name", ["pendulum-50", "truck-50", "fish-50", "dolphin-50"])
def test_the_tensors_of_an_emulator_are_those_of_the_table(name: str):
    emulator = load_emulator(name)
    assert without_numbers(emulator_tensors(emulator)) == expected_names(emulator)


def test_the_table_is_of_every_network_and_of_nothing_else():
    assert {*documented()} == {
        *NETWORKS,
        "all",
        "deformable bodies",
        "soft bodies",
        "trust",
        "error bounds",
        "validation",
        "validation_window",
    }


def test_the_tensors_of_a_policy_are_those_of_its_emulator_and_of_its_network():
    policy = load_policy("fish")
    emulator = {f"emulator.{name}" for name in expected_names(policy.emulator)}
    names = without_numbers(policy.leaves())
    assert names == emulator | network_names(policy.network)
