"""Every network by name."""

from __future__ import annotations

from typing import Any

from jaxtyping import PRNGKeyArray

from neuroanimator.emulator.checks import MAX_LAYER
from neuroanimator.emulator.features import rising
from neuroanimator.emulator.networks.classic import Classic
from neuroanimator.emulator.networks.gated import Gated
from neuroanimator.emulator.networks.glu import Glu, LinearGlu
from neuroanimator.emulator.networks.hierarchy import (
    Hierarchy,
    parts_from_json,
    parts_to_json,
)
from neuroanimator.emulator.networks.mirrored import Mirrored
from neuroanimator.emulator.networks.network import Network, NetworkShape, Part
from neuroanimator.errors import ArgumentError
from neuroanimator.files.numbers import flag, listed, whole
from neuroanimator.text import quoted

NETWORKS: dict[str, type[Network]] = {
    "gated": Gated,
    "classic": Classic,
    "glu": Glu,
    "linear-glu": LinearGlu,
    "mirrored": Mirrored,
    "hierarchy": Hierarchy,
}
"""Every network by its name in files and settings, the default first."""

DEFAULT_WIDTHS = {kind: network.usual_widths for kind, network in NETWORKS.items()}

MAX_LAYERS = 32
"""Maximum number of hidden layers, in total for a hierarchy; each is traced one by one."""


def check_widths(kind: str, widths: tuple[int, ...]) -> None:
    """Refuse hidden layers that no emulator file may have; ArgumentError names them."""
    if any(width < 1 for width in widths if kind != "hierarchy"):
        raise ArgumentError(
            f"widths: wanted at least 1 unit in every hidden layer, got {list(widths)[:MAX_LAYERS]}."
        )
    if len(widths) > MAX_LAYERS:
        raise ArgumentError(
            f"widths: wanted at most {MAX_LAYERS} hidden layers, got {len(widths)}."
        )
    for width in widths:
        if width > MAX_LAYER:
            raise ArgumentError(
                f"widths: wanted at most {MAX_LAYER} units in a hidden layer, got {width}."
            )


def make_network(
    kind: str,
    odd: int,
    even: int,
    out: int,
    widths: tuple[int, ...],
    key: PRNGKeyArray | None,
    even_out: tuple[int, ...] = (),
    parts: tuple[Part, ...] = (),
    *,
    gates_even: bool = False,
) -> Network:
    """Return a fresh network of `kind`, see `NetworkShape`; without a `key` its weights are zeros."""
    check_widths(kind, widths)
    if kind not in NETWORKS:
        raise ArgumentError(f"No network called '{kind}'. Networks: {', '.join(sorted(NETWORKS))}.")
    shape = NetworkShape(odd, even, out, widths, even_out, parts, gates_even)
    return NETWORKS[kind].of(shape, key=key)


def network_to_json(network: Network) -> dict[str, Any]:
    """Return everything but the weights of a network."""
    kinds = {maker: name for name, maker in NETWORKS.items()}
    described = {
        "kind": kinds[type(network)],
        "widths": network.widths,
        "even": getattr(network, "even", ()),
        "parts": parts_to_json(getattr(network, "parts", ())),
    }
    if getattr(network, "gates_even", False):
        described["gates_even"] = True
    return described


def blank_network(described: dict[str, Any], sizes: tuple[int, int], changes: int) -> Network:
    """Return the network that `network_to_json` wrote, with zero weights.

    `sizes` are those of its odd and even streams; it predicts `changes` numbers.
    """
    kind = described["kind"]
    widths = listed(described["widths"], "widths", layer_width)
    even = rising(described["even"], changes)
    parts = parts_from_json(described["parts"])
    gates_even = flag(described.get("gates_even", False), "network: gates_even")
    network = make_network(kind, *sizes, changes, widths, None, even, parts, gates_even=gates_even)
    if getattr(network, "gates_even", False) != gates_even:
        raise ValueError(f"network: {quoted(kind)} does not gate its even units")
    if (getattr(network, "even", ()), getattr(network, "parts", ())) != (even, parts):
        raise ValueError(f"network: {quoted(kind)} has no even answers or no parts")
    return network


def layer_width(value: Any, what: str) -> int:
    """Return a number of units in a file."""
    return whole(value, what, 0, MAX_LAYER)
