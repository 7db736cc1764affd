"""One emulator, one safetensors file: everything needed to use it, nothing executable."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import numpy as np

from neuroanimator.appearance.skeleton import UNIT_TOLERANCE, Skeleton
from neuroanimator.definitions.carried import check_carried
from neuroanimator.emulator.domain import Domain
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.emulator.encoding import IdentityEncoding
from neuroanimator.emulator.features import Features
from neuroanimator.emulator.networks import MAX_LAYER, NETWORKS, make_network
from neuroanimator.emulator.networks.hierarchy import parts_from_json, parts_to_json
from neuroanimator.emulator.normaliser import Normaliser
from neuroanimator.emulator.shape_modes import ShapeModes
from neuroanimator.emulator.spec import EmulatorSpec
from neuroanimator.errors import ArgumentError, BadFileError
from neuroanimator.parsing.names import check_system_name
from neuroanimator.parsing.numbers import entries, flag, listed, number, numbers, whole
from neuroanimator.state.body_frame import Frame
from neuroanimator.state.gait import Gait
from neuroanimator.state.layout import Bounds, Layout
from neuroanimator.state.segments import (
    Points,
    PointVelocities,
    moves_freely,
    segments_from_json,
    segments_to_json,
)
from neuroanimator.storage.files import read_tensors, write_tensors
from neuroanimator.storage.program_cache import keep_programs
from neuroanimator.text import printable, quoted

FORMAT = 5
"""Raised whenever an older reader would misunderstand a file."""

MAX_SUBSTEPS = 1000
"""As many as a definition or a dataset may ask for."""

MIN_STEP, MAX_STEP = 1e-9, 3600.0
"""[s] Of one physics step, or of one interval of recordings; times closer than the first are the same time."""

MAX_PROBES = 256
"""Round parts whose height an emulator is shown: each is a feature."""

MAX_DISTANCE = 1e6
"""[m] Largest coordinate of a probe."""

TRIAL_NAME = "trial.emulator.safetensors"
"""Of a file that is there for a moment before a training."""

MAX_FAULT = 300
"""Characters of an error that are shown."""


def tensors_of(tree: Any) -> dict[str, np.ndarray]:
    """Return every array in a pytree under its dotted path."""
    leaves, _ = jax.tree_util.tree_flatten_with_path(eqx.filter(tree, eqx.is_array))
    return {_name(path): np.asarray(leaf) for path, leaf in leaves}


def _name(path: Any) -> str:
    return jax.tree_util.keystr(path).replace(".encoding.", ".modes.").replace(".limits", ".reach")


def with_tensors(tree: Any, tensors: dict[str, np.ndarray]) -> Any:
    """Return `tree` with its arrays replaced; ValueError unless names and shapes are exactly the same."""
    paths, structure = jax.tree_util.tree_flatten_with_path(tree)
    names = [_name(path) for path, _ in paths]
    if set(names) != set(tensors):
        wrong = sorted(set(names) ^ set(tensors))[0]
        raise ValueError(f"tensor {quoted(wrong)} is missing or not expected")
    for name, (_, leaf) in zip(names, paths, strict=True):
        if tensors[name].shape != leaf.shape:
            raise ValueError(
                f"tensor '{name}' has shape {tensors[name].shape}; wanted {leaf.shape}"
            )
        if tensors[name].dtype.kind != leaf.dtype.kind:
            raise ValueError(f"tensor '{name}' holds {tensors[name].dtype}; wanted {leaf.dtype}")
        if leaf.dtype.kind == "f" and (np.abs(tensors[name]) > np.finfo(np.float32).max).any():
            raise ValueError(f"tensor '{name}' holds a number that float32 has no room for")
    arrays = [jax.device_put(tensors[name]) for name in names]
    return jax.tree_util.tree_unflatten(structure, arrays)


def save(emulator: Emulator, path: Path, provenance: dict[str, Any] | None = None) -> None:
    """Write `emulator`; `provenance` says what it was trained on and how (any JSON)."""
    write_tensors(
        path, tensors_of(emulator), {**describe(emulator), "provenance": provenance or {}}
    )


def check_readable(emulator: Emulator, folder: Path, provenance: dict[str, Any]) -> None:
    """Write `emulator` to a file in `folder`, read it back and remove it: before a training, not after it.

    Raises ArgumentError for whatever `load` would refuse, such as a state that is too long.
    """
    trial = folder / TRIAL_NAME
    try:
        save(emulator, trial, provenance)
        load(trial)
    except BadFileError as error:
        raise ArgumentError(
            f"Such an emulator could not be read back once it is trained: {error}"
        ) from error
    finally:
        trial.unlink(missing_ok=True)


def describe(emulator: Emulator) -> dict[str, Any]:
    """Return the metadata that, with the tensors, makes up the emulator."""
    spec, features, network = emulator.spec, emulator.features, emulator.network
    kind = next(name for name, maker in NETWORKS.items() if type(network) is maker)
    return {
        "kind": "emulator",
        "format": FORMAT,
        "system": spec.system,
        "state": spec.state.to_json(),
        "control": spec.control.to_json(),
        "bounds": [list(spec.bounds.low), list(spec.bounds.high)],
        "definition": spec.definition,
        "rest": list(spec.rest),
        "gait": None if spec.gait is None else spec.gait.to_json(),
        "substeps": spec.substeps,
        "dt": spec.dt,
        "skeleton": spec.skeleton.to_json(),
        "rates": [list(pair) for pair in spec.rates],
        "modes": emulator.encoding.to_json(),
        "frame": {
            "segments": segments_to_json(emulator.frame.segments),
            "probes": [list(probe) for probe in emulator.frame.probes],
            "has_gravity": emulator.frame.has_gravity,
            "is_immersed": emulator.frame.is_immersed,
            "external_forces": [list(row) for row in emulator.frame.external_forces],
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
    """Return the emulator at `path`, every name, text, shape and number checked."""
    keep_programs()
    tensors, metadata = read_tensors(path, "emulator")
    check_format(path, metadata.get("format"), FORMAT)
    try:
        emulator = with_tensors(jax.eval_shape(lambda: blank(metadata)), tensors)
        check_arrays(emulator)
    except FAULTS as error:
        raise BadFileError(
            f"{path} is not a usable emulator: {first_line(error)}. Make it again."
        ) from error
    return emulator


def check_arrays(emulator: Emulator) -> None:
    """Refuse weights that make every prediction NaN: ranges without an inside, numbers divided by nothing."""
    if not (np.asarray(emulator.domain.low) <= np.asarray(emulator.domain.high)).all():
        raise ValueError("domain: wanted low below high")
    if (np.asarray(emulator.normaliser.plain_scale) <= 0).any():
        raise ValueError("normaliser or modes: wanted scales above 0")
    emulator.encoding.check()
    changes = [emulator.normaliser.change_scale, emulator.normaliser.unit]
    if any(
        (np.asarray(scale) < 0).any() for scale in changes
    ):  # zero: what never moves stands still
        raise ValueError("normaliser: wanted scales of at least 0")


FAULTS = (
    KeyError,
    TypeError,
    ValueError,
    IndexError,
    ArithmeticError,
    RecursionError,
    AttributeError,
    BadFileError,
)
"""What reading metadata that a stranger wrote may end in."""


def check_format(path: Path, found: Any, wanted: int) -> None:
    """Refuse a file of another format; say whether the file or this program is the older one."""
    if isinstance(found, bool) or not isinstance(found, int) or found < 1:
        raise BadFileError(
            f"{path} does not say its format; this version reads {wanted}. Make it again."
        )
    if found < wanted:
        raise BadFileError(
            f"{path} is of an older version: format {found}; this one reads {wanted}. Make it again."
        )
    if found > wanted:
        raise BadFileError(
            f"{path} is of a newer version: format {quoted(found)}; this one reads {wanted}. Upgrade NeuroAnimator."
        )


def first_line(error: Exception) -> str:
    """Return what `error` says as one line, of which whatever comes from the file is harmless to show."""
    if isinstance(error, KeyError):
        return f"it has no {quoted(error.args[0])}"
    text = " ".join(str(error).split())[:MAX_FAULT].rstrip(".")
    return printable(text) or type(error).__name__


def read_metadata(path: Path) -> dict[str, Any]:
    """Return what the file at `path` says about itself."""
    return read_tensors(path, "emulator")[1]


def blank(metadata: dict[str, Any]) -> Emulator:
    """Return an emulator of the described structure with zeros for weights."""
    zeros = jax.numpy.zeros
    spec = _spec(metadata)
    state, control = spec.state, spec.control
    described, layers = metadata["features"], metadata["network"]
    encoding = IdentityEncoding(state)
    if metadata["modes"] is not None:
        encoding = ShapeModes.from_json(metadata["modes"], state.size, control.size)
    latent = encoding.layout.size
    plain = entries(described["plain"], "features: plain", latent)
    rows = whole(described["rows"], "features: rows", 0, MAX_LAYER)
    widths = listed(
        layers["widths"], "widths", lambda width, what: whole(width, what, 0, MAX_LAYER)
    )
    frame = _frame(metadata["frame"], latent, control.size, spec.dt)
    others, changes = frame.local_size + frame.control_size(control.size), frame.change_size(latent)
    seen = len(plain) + others
    even, even_out = _rising(described["even"], seen), _rising(layers["even"], changes)
    parts = parts_from_json(layers["parts"])
    features = Features(
        zeros((rows, latent)), plain, flag(described["is_odd"], "features: is_odd"), even
    )
    network = make_network(
        layers["kind"], *features.sizes(others), changes, widths, jax.random.key(0), even_out, parts
    )
    if (getattr(network, "even", ()), getattr(network, "parts", ())) != (even_out, parts):
        raise ValueError(f"network: {quoted(layers['kind'])} has no even answers or no parts")
    return Emulator(
        frame=frame,
        features=features,
        normaliser=Normaliser(
            zeros(seen), zeros(seen), zeros(changes), zeros(changes), zeros(changes)
        ),
        network=network,
        domain=Domain(zeros(seen), zeros(seen)),
        spec=spec,
        encoding=encoding,
    )


def _spec(metadata: dict[str, Any]) -> EmulatorSpec:
    """Return what the emulator stands for: its text held to the rules of definitions, its numbers finite."""
    state = Layout.from_json(metadata["state"], "state")
    control = Layout.from_json(metadata["control"], "control")
    substeps = whole(metadata["substeps"], "substeps", 1, MAX_SUBSTEPS)
    dt = number(metadata["dt"], "dt", MIN_STEP * substeps, MAX_STEP * substeps)
    system, definition = check_system_name(metadata["system"]), metadata["definition"]
    if not isinstance(definition, str):
        raise ValueError("definition: wanted a text")
    if definition:
        check_carried(system, definition, substeps, dt)

    def index(entry, what):
        return whole(entry, what, 0, state.size - 1)

    rates = listed(metadata["rates"], "rates", lambda pair, what: listed(pair, what, index, 2))
    if len({position for position, _ in rates}) < len(rates):
        raise ValueError("rates: an entry has two")
    return EmulatorSpec(
        system=system,
        state=state,
        control=control,
        bounds=Bounds.from_json(metadata["bounds"], control.size, "bounds"),
        rest=_rest(metadata["rest"], state),
        definition=definition,
        gait=None if metadata["gait"] is None else Gait.from_json(metadata["gait"], control.size),
        substeps=substeps,
        dt=dt,
        skeleton=Skeleton.from_json(metadata["skeleton"], state.size),
        rates=tuple((position, rate) for position, rate in rates),
    )


def _rest(values: Any, state: Layout) -> tuple[float, ...]:
    """Return the state of rest, whose quaternions have a length: an orientation of zeros makes poses NaN."""
    rest = numbers(values, "rest", state.size)
    for part in state.slices:
        if part.unit == "quaternion":
            norm = np.linalg.norm(rest[state.index(part.name)])
            if abs(norm - 1) > UNIT_TOLERANCE:
                raise ValueError(
                    f"rest: '{part.name}' is a quaternion of length {norm:g}; wanted 1"
                )
    return rest


def _rising(values: Any, size: int) -> tuple[int, ...]:
    """Return `values` if they rise and are below `size`."""
    found = entries(values, "features: even", size)
    if list(found) != sorted({*found}):
        raise ValueError("features: even entries out of order")
    return found


def _frame(described: dict[str, Any], state_size: int, controls: int, dt: float) -> Frame:
    segments = segments_from_json(described["segments"])
    probes = listed(
        described["probes"], "frame: probes", lambda row, what: numbers(row, what, 4, MAX_DISTANCE)
    )
    if len(probes) > MAX_PROBES:
        raise ValueError(f"frame: {len(probes)} probes; wanted at most {MAX_PROBES}")
    if segments and sum(segment.size for segment in segments) != state_size:
        raise ValueError("frame: its segments do not fill the state")
    if any(isinstance(segment, Points | PointVelocities) for segment in segments):
        raise ValueError("frame: mass points are decoded by modes")
    if any(segment.rate >= state_size - 1 for segment in segments):
        raise ValueError("frame: a rate lies outside the state")
    if probes and not moves_freely(segments):
        raise ValueError("frame: probes need a root that moves freely")
    external_forces = listed(
        described["external_forces"],
        "frame: pushes",
        lambda row, what: numbers(row, what, controls),
    )
    if len(external_forces) not in (0, 3):
        raise ValueError("frame: wanted external forces along three axes, or none")
    has_gravity = flag(described["has_gravity"], "frame: weighs")
    is_immersed = flag(described["is_immersed"], "frame: is_immersed")
    spheres = tuple((x, y, z, r) for x, y, z, r in probes)
    return Frame(segments, spheres, dt, has_gravity, is_immersed, external_forces=external_forces)
