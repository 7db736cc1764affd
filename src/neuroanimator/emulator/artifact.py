"""One emulator, one safetensors file: everything needed to use it, nothing executable."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import numpy as np

from neuroanimator.emulator.emulator import Domain, Emulator, Identity
from neuroanimator.emulator.features import Features
from neuroanimator.emulator.frame import Frame
from neuroanimator.emulator.hierarchy import parts_from_json, parts_to_json
from neuroanimator.emulator.modes import Modes
from neuroanimator.emulator.networks import NETWORKS, make_network
from neuroanimator.emulator.normaliser import Normaliser
from neuroanimator.errors import ArgumentError, BadFileError
from neuroanimator.files import read_tensors, write_tensors
from neuroanimator.systems.gait import Gait
from neuroanimator.systems.layout import Bounds, Layout
from neuroanimator.systems.skeleton import Skeleton
from neuroanimator.systems.structure import segments_from_json, segments_to_json

FORMAT = 4
"""Raised whenever an older reader would misunderstand a file."""

WIDEST_LAYER = 4096
"""Widest hidden layer read from a file: bounds what a hostile header can make us allocate."""


def tensors_of(tree: Any) -> dict[str, np.ndarray]:
    """Return every array in a pytree under its dotted path."""
    leaves, _ = jax.tree_util.tree_flatten_with_path(eqx.filter(tree, eqx.is_array))
    return {jax.tree_util.keystr(path): np.asarray(leaf) for path, leaf in leaves}


def with_tensors(tree: Any, tensors: dict[str, np.ndarray]) -> Any:
    """Return `tree` with its arrays replaced; ValueError unless names and shapes are exactly the same."""
    paths, structure = jax.tree_util.tree_flatten_with_path(tree)
    names = [jax.tree_util.keystr(path) for path, _ in paths]
    if set(names) != set(tensors):
        wrong = sorted(set(names) ^ set(tensors))[0]
        raise ValueError(f"tensor '{wrong[:60]}' is missing or not expected")
    for name, (_, leaf) in zip(names, paths, strict=True):
        if tensors[name].shape != leaf.shape:
            raise ValueError(f"tensor '{name}' has shape {tensors[name].shape}; wanted {leaf.shape}")
    arrays = [jax.numpy.asarray(tensors[name]) for name in names]
    return jax.tree_util.tree_unflatten(structure, arrays)


def save(emulator: Emulator, path: Path, provenance: dict[str, Any] | None = None) -> None:
    """Write `emulator`; `provenance` says what it was trained on and how (any JSON)."""
    write_tensors(path, tensors_of(emulator), {**describe(emulator), "provenance": provenance or {}})


def describe(emulator: Emulator) -> dict[str, Any]:
    """Return the metadata that, with the tensors, makes up the emulator."""
    identity, features, network = emulator.identity, emulator.features, emulator.network
    kind = next(name for name, maker in NETWORKS.items() if type(network) is maker)
    return {
        "kind": "emulator",
        "format": FORMAT,
        "system": identity.system,
        "state": identity.state.to_json(),
        "control": identity.control.to_json(),
        "bounds": [list(identity.bounds.low), list(identity.bounds.high)],
        "definition": identity.definition,
        "rest": list(identity.rest),
        "gait": None if identity.gait is None else identity.gait.to_json(),
        "substeps": identity.substeps,
        "dt": identity.dt,
        "skeleton": identity.skeleton.to_json(),
        "rates": [list(pair) for pair in identity.rates],
        "modes": None if emulator.modes is None else emulator.modes.to_json(),
        "frame": {
            "segments": segments_to_json(emulator.frame.segments),
            "probes": [list(probe) for probe in emulator.frame.probes],
            "weighs": emulator.frame.weighs,
            "is_immersed": emulator.frame.is_immersed,
            "pushes": [list(row) for row in emulator.frame.pushes],
        },
        "features": {
            "rows": features.angles.shape[0],
            "plain": list(features.plain),
            "is_odd": features.is_odd,
            "even": list(features.even),
        },
        "network": {
            "kind": kind,
            "widths": list(network.widths),
            "even": list(getattr(network, "even", ())),
            "parts": parts_to_json(getattr(network, "parts", ())),
        },
    }


def load(path: Path) -> Emulator:
    """Return the emulator at `path`, every name, shape and number checked."""
    tensors, metadata = read_tensors(path, "emulator")
    if metadata.get("format") != FORMAT:
        raise BadFileError(
            f"{path} has format {metadata.get('format')!r}; this version reads {FORMAT}. Upgrade NeuroAnimator."
        )
    try:
        return with_tensors(jax.eval_shape(lambda: blank(metadata)), tensors)
    except (KeyError, TypeError, ValueError, IndexError, OverflowError, ArgumentError) as error:
        raise BadFileError(f"{path} is not a usable emulator: {error}. Train it again.") from error


def read_metadata(path: Path) -> dict[str, Any]:
    """Return what the file at `path` says about itself."""
    return read_tensors(path, "emulator")[1]


def blank(metadata: dict[str, Any]) -> Emulator:
    """Return an emulator of the described structure with zeros for weights."""
    state, control = Layout.from_json(metadata["state"]), Layout.from_json(metadata["control"])
    described = metadata["features"]
    zeros = jax.numpy.zeros
    plain = tuple(int(entry) for entry in described["plain"])
    rows, widths = int(described["rows"]), tuple(int(width) for width in metadata["network"]["widths"])
    modes = None if metadata["modes"] is None else Modes.from_json(metadata["modes"], state.size, control.size)
    inner = state.size if modes is None else modes.size
    bounds = Bounds(*(tuple(float(value) for value in side) for side in metadata["bounds"]))
    rest = tuple(float(value) for value in metadata["rest"])
    if max(state.size, control.size, rows, *widths) > WIDEST_LAYER:
        raise ValueError("sizes out of range")
    if (len(bounds.low), len(bounds.high), len(rest)) != (control.size, control.size, state.size):
        raise ValueError("bounds or rest: other sizes than control and state")
    rates = [entry for pair in metadata["rates"] for entry in pair]
    if any(not 0 <= entry < inner for entry in plain) or any(not 0 <= entry < state.size for entry in rates):
        raise ValueError("features: an entry lies outside the state")
    frame = _frame(metadata["frame"], inner, control.size, float(metadata["dt"]))
    others, changes = frame.local_size + frame.control_size(control.size), frame.change_size(inner)
    numbers = len(plain) + others
    even, even_out = _rising(described["even"], numbers), _rising(metadata["network"]["even"], changes)
    parts = parts_from_json(metadata["network"]["parts"])
    features = Features(zeros((rows, inner)), plain, bool(described["is_odd"]), even)
    network = make_network(
        metadata["network"]["kind"], *features.sizes(others), changes, widths, jax.random.key(0), even_out, parts
    )
    return Emulator(
        frame=frame,
        features=features,
        normaliser=Normaliser(zeros(numbers), zeros(numbers), zeros(changes), zeros(changes), zeros(changes)),
        network=network,
        domain=Domain(zeros(numbers), zeros(numbers)),
        identity=Identity(
            system=str(metadata["system"]),
            state=state,
            control=control,
            bounds=bounds,
            rest=rest,
            definition=str(metadata["definition"]),
            gait=None if metadata["gait"] is None else Gait.from_json(metadata["gait"], control.size),
            substeps=int(metadata["substeps"]),
            dt=float(metadata["dt"]),
            skeleton=Skeleton.from_json(metadata["skeleton"], state.size),
            rates=tuple((int(position), int(rate)) for position, rate in metadata["rates"]),
        ),
        modes=modes,
    )


def _rising(entries: list[int], size: int) -> tuple[int, ...]:
    """Return `entries` if they rise and are below `size`."""
    found = tuple(int(entry) for entry in entries)
    if list(found) != sorted({*found}) or any(not 0 <= entry < size for entry in found):
        raise ValueError("features: even entries out of order")
    return found


def _frame(described: dict[str, Any], state_size: int, controls: int, dt: float) -> Frame:
    segments = segments_from_json(described["segments"])
    probes = tuple((float(x), float(y), float(z), float(r)) for x, y, z, r in described["probes"])
    if segments and sum(segment.size for segment in segments) != state_size:
        raise ValueError("frame: its segments do not fill the state")
    if any("point" in segment.kind for segment in segments):
        raise ValueError("frame: mass points are decoded by modes")
    if any(segment.rate >= state_size - 1 or segment.rate < -1 for segment in segments):
        raise ValueError("frame: a rate lies outside the state")
    if probes and {"position", "quaternion", "velocity"} - {segment.kind for segment in segments}:
        raise ValueError("frame: probes need a root that moves freely")
    pushes = tuple(tuple(float(force) for force in row) for row in described["pushes"])
    if pushes and (len(pushes) != 3 or any(len(row) != controls for row in pushes)):
        raise ValueError("frame: pushes of another size than the control")
    weighs = bool(described["weighs"])
    is_immersed = bool(described["is_immersed"])
    return Frame(segments, probes, dt, weighs, is_immersed, pushes=pushes)
