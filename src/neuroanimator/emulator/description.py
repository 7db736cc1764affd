"""An emulator written down: everything but its arrays, as JSON, and the blank emulator made from it."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, TypeVar

import numpy as np

from neuroanimator.appearance.shapes import Shapes
from neuroanimator.appearance.skeleton import UNIT_TOLERANCE, Skeleton
from neuroanimator.emulator.arrays import zeros
from neuroanimator.emulator.domain import Domain
from neuroanimator.emulator.encoding import Encoding, IdentityEncoding
from neuroanimator.emulator.error_bounds import KINDS, ErrorBounds, blank_bounds
from neuroanimator.emulator.features import Features
from neuroanimator.emulator.networks import MAX_LAYER, NETWORKS, make_network
from neuroanimator.emulator.networks.hierarchy import parts_from_json, parts_to_json
from neuroanimator.emulator.networks.network import Network
from neuroanimator.emulator.normaliser import Normaliser
from neuroanimator.emulator.shape_modes import ShapeModes
from neuroanimator.emulator.spec import MAX_GAIN, MAX_STRIDES, EmulatorSpec, Engine
from neuroanimator.emulator.super_step import SuperStep
from neuroanimator.emulator.trust import TrustMeter
from neuroanimator.emulator.verdict import blank_errors
from neuroanimator.files.names import check_system_name
from neuroanimator.files.numbers import entries, flag, listed, number, numbers, whole
from neuroanimator.state.body_frame import Frame
from neuroanimator.state.contacts import Contacts
from neuroanimator.state.gait import Gait
from neuroanimator.state.kinematics import Kinematics
from neuroanimator.state.layout import MAX_NUMBERS, Bounds, Layout
from neuroanimator.state.placement import Placement
from neuroanimator.state.segments import (
    Constant,
    Driven,
    Lag,
    Points,
    PointVelocities,
    moves_freely,
    place_segments,
    segments_from_json,
    segments_to_json,
)
from neuroanimator.state.shape_contacts import ShapeContacts
from neuroanimator.state.structure import Probe
from neuroanimator.text import quoted

FORMAT = 5
"""Version of the file format, raised whenever an older reader would misunderstand a file."""

Made = TypeVar("Made", bound=SuperStep)
"""Class of the emulator made from a description."""

MAX_SUBSTEPS = 1000
"""Maximum number of physics steps in a super step, as in definitions and datasets."""

MIN_STEP = 1e-9
"""Minimum physics step, or interval of recordings [s]; times closer than this count as equal."""

MAX_STEP = 3600.0
"""Maximum physics step, or interval of recordings [s]."""

MAX_PROBES = 256
"""Maximum number of round parts whose heights are features."""

MAX_LEVELS = 32
"""Maximum number of levels of error bounds."""

MAX_HORIZON = 4096
"""Maximum number of super steps with error bounds."""

MAX_DISTANCE = 1e6
"""Maximum coordinate of a probe [m]."""


RELEASE = r"[\w.+-]{1,40}"
"""Pattern of the release of a physics engine."""


def describe(emulator: SuperStep) -> dict[str, Any]:
    """Return the metadata that, together with the tensors, makes up the emulator.

    Parts that an emulator lacks are left out, so that older files keep their contents.
    """
    described = {
        "kind": "emulator",
        "format": FORMAT,
        **_describe_spec(emulator.spec),
        "modes": emulator.encoding.to_json(),
        "frame": _describe_frame(emulator.frame),
        "features": _describe_features(emulator.features),
        "network": _describe_network(emulator.network),
    }
    if emulator.frame.contacts is not None:
        described["contacts"] = emulator.frame.contacts.to_json()
    shapes = emulator.skeleton.shapes
    if shapes is not None:
        described["shapes"] = {"first": shapes.first} | _describe_placement(shapes.placement)
    if emulator.frame.shape_contacts is not None:
        described["shape_contacts"] = emulator.frame.shape_contacts.to_json()
    if emulator.spec.is_tied:
        described["tied"] = True
    if emulator.strides > 1:
        described["strides"] = emulator.strides
    meter = emulator.meter
    if meter is not None:
        described["trust"] = [meter.odd.shape[1], meter.even.shape[1]]
    if emulator.calibration is not None:
        described["errors"] = _describe_errors(emulator.calibration)
    if emulator.validation is not None:
        described["validation"] = True
        if emulator.validation.window is not None:
            described["validation_window"] = True
    return described


def _describe_placement(placement: Placement) -> dict[str, int]:
    return {
        "position": placement.position,
        "heading": placement.heading,
        "orientation": placement.orientation,
    }


def _describe_errors(bounds: ErrorBounds) -> dict[str, Any]:
    return {
        "kinds": len(bounds.weights),
        "levels": list(bounds.levels),
        "steps": bounds.steps,
        "numbers": len(bounds.unit),
    }


def _describe_spec(spec: EmulatorSpec) -> dict[str, Any]:
    gait = None
    if spec.gait is not None:
        gait = spec.gait.to_json()
    described: dict[str, Any] = {
        "system": spec.system,
        "state": spec.state.to_json(),
        "control": spec.control.to_json(),
        "bounds": spec.bounds.to_json(),
        "definition": spec.definition,
        "rest": list(spec.rest),
        "gait": gait,
        "substeps": spec.substeps,
        "dt": spec.dt,
        "skeleton": spec.skeleton.to_json(),
        "rates": [list(pair) for pair in spec.rates],
    }
    if spec.engine is not None:
        described["engine"] = spec.engine._asdict()
    return described


def _describe_frame(frame: Frame) -> dict[str, Any]:
    return {
        "segments": segments_to_json(frame.segments),
        "probes": [list(probe) for probe in frame.probes],
        "has_gravity": frame.has_gravity,
        "is_immersed": frame.is_immersed,
        "external_forces": [list(row) for row in frame.external_forces],
    }


def _describe_features(features: Features) -> dict[str, Any]:
    return {
        "rows": features.angles.shape[0],
        "plain": list(features.plain),
        "is_odd": features.is_odd,
        "even": list(features.even),
    }


def _describe_network(network: Network) -> dict[str, Any]:
    name = next(name for name, maker in NETWORKS.items() if type(network) is maker)
    described = {
        "kind": name,
        "widths": list(network.widths),
        "even": list(getattr(network, "even", ())),
        "parts": parts_to_json(getattr(network, "parts", ())),
    }
    if getattr(network, "gates_even", False):
        described["gates_even"] = True
    return described


def blank(
    metadata: dict[str, Any], kind: type[Made], shapes: Mapping[str, np.ndarray] | None = None
) -> Made:
    """Return an emulator of the described structure with zero weights; `shapes` are the arrays of a soft body's shapes.

    Raises one of `artifact.FAULTS` for anything invalid.
    """
    spec = _spec(metadata)
    if "shapes" in metadata:
        spec = replace(spec, skeleton=_with_shapes(metadata["shapes"], shapes or {}, spec))
    controls = spec.control.size
    encoding = _encoding(metadata["modes"], spec)
    latent_size = encoding.layout.size
    frame = _frame(metadata["frame"], latent_size, controls, spec.dt / spec.strides)
    if "contacts" in metadata:
        frame = replace(frame, contacts=_contacts(metadata["contacts"], frame, spec))
    if "shape_contacts" in metadata:
        contacts = _shape_contacts(metadata["shape_contacts"], frame, spec)
        frame = replace(frame, shape_contacts=contacts)
    others = frame.local_size + frame.control_size(controls)
    changes = frame.change_size(latent_size)
    features = _features(metadata["features"], latent_size, others)
    feature_count = len(features.plain) + others
    normaliser = Normaliser(
        plain_mean=zeros(feature_count),
        plain_scale=zeros(feature_count),
        change_mean=zeros(changes),
        change_scale=zeros(changes),
        unit=zeros(changes),
    )
    _check_parameters(frame, features, spec, encoding)
    network = _network(metadata["network"], features.sizes(others), changes)
    meter = None
    if "trust" in metadata:
        meter = _meter(metadata["trust"], network)
    validation = None
    if flag(metadata.get("validation", False), "validation"):
        has_window = flag(metadata.get("validation_window", False), "validation_window")
        validation = blank_errors(has_window=has_window)
    return kind(
        frame=frame,
        features=features,
        normaliser=normaliser,
        network=network,
        domain=Domain(zeros(feature_count), zeros(feature_count)),
        spec=spec,
        encoding=encoding,
        meter=meter,
        calibration=_errors(metadata["errors"]) if "errors" in metadata else None,
        validation=validation,
    )


def _meter(described: Any, network: Network) -> TrustMeter:
    """Return a meter of the units of `network` with the described number of directions."""
    odd, even = listed(described, "trust", _layer_width, 2)
    if odd + even == 0:
        raise ValueError("trust: wanted a direction or more")
    odd_units, even_units = network.unit_counts
    return TrustMeter(zeros(odd_units, odd), zeros(even_units, even), zeros(even_units))


def _errors(described: dict[str, Any]) -> ErrorBounds:
    """Return error bounds of the described shape."""
    levels = numbers(described["levels"], "errors: levels")
    if not 1 <= len(levels) <= MAX_LEVELS or list(levels) != sorted({*levels}):
        raise ValueError(f"errors: wanted 1 to {MAX_LEVELS} levels that rise")
    if not 0 < levels[0] <= levels[-1] < 1:
        raise ValueError("errors: wanted levels between 0 and 1")
    return blank_bounds(
        whole(described["kinds"], "errors: kinds", 1, len(KINDS)),
        levels,
        whole(described["steps"], "errors: steps", 1, MAX_HORIZON),
        whole(described["numbers"], "errors: numbers", 1, MAX_NUMBERS),
    )


def _encoding(described: Any, spec: EmulatorSpec) -> Encoding:
    """Return the encoding that `Encoding.to_json` wrote."""
    if described is None:
        return IdentityEncoding(spec.state)
    return ShapeModes.from_json(described, spec.state.size, spec.control.size)


def _features(described: dict[str, Any], latent_size: int, others: int) -> Features:
    """Return the features of a latent state with `others` further raw ones."""
    plain = entries(described["plain"], "features: plain", latent_size)
    rows = whole(described["rows"], "features: rows", 0, MAX_LAYER)
    even = _rising(described["even"], len(plain) + others)
    is_odd = flag(described["is_odd"], "features: is_odd")
    return Features(zeros(rows, latent_size), plain, is_odd, even)


def _network(described: dict[str, Any], sizes: tuple[int, int], changes: int) -> Network:
    """Return a network for odd and even streams of these `sizes` that predicts `changes` numbers."""
    kind = described["kind"]
    odd_size, even_size = sizes
    widths = listed(described["widths"], "widths", _layer_width)
    even = _rising(described["even"], changes)
    parts = parts_from_json(described["parts"])
    gates_even = flag(described.get("gates_even", False), "network: gates_even")
    network = make_network(
        kind, odd_size, even_size, changes, widths, None, even, parts, gates_even=gates_even
    )
    if getattr(network, "gates_even", False) != gates_even:
        raise ValueError(f"network: {quoted(kind)} does not gate its even units")
    if (getattr(network, "even", ()), getattr(network, "parts", ())) != (even, parts):
        raise ValueError(f"network: {quoted(kind)} has no even answers or no parts")
    return network


def _layer_width(value: Any, what: str) -> int:
    return whole(value, what, 0, MAX_LAYER)


def _spec(metadata: dict[str, Any]) -> EmulatorSpec:
    """Return the emulator's spec, its text checked by the rules of definitions, its numbers finite."""
    state = Layout.from_json(metadata["state"], "state")
    control = Layout.from_json(metadata["control"], "control", least=0)
    substeps = whole(metadata["substeps"], "substeps", 1, MAX_SUBSTEPS)
    dt = number(metadata["dt"], "dt", MIN_STEP * substeps, MAX_STEP * substeps)
    system = check_system_name(metadata["system"])
    definition = metadata["definition"]
    if not isinstance(definition, str):
        raise ValueError("definition: wanted a text")
    if definition:
        # Shipped emulators carry none, and the tables of definitions take long to import.
        from neuroanimator.definitions.carried import check_carried

        check_carried(system, definition, substeps, dt)

    def index(entry: Any, what: str) -> int:
        return whole(entry, what, 0, state.size - 1)

    rates = listed(metadata["rates"], "rates", lambda pair, what: listed(pair, what, index, 2))
    if len({position for position, _ in rates}) < len(rates):
        raise ValueError("rates: an entry has two")
    gait = None
    if metadata["gait"] is not None:
        gait = Gait.from_json(metadata["gait"], control.size)
    engine = None
    if "engine" in metadata:
        release = metadata["engine"]["release"]
        if not isinstance(release, str) or not re.fullmatch(RELEASE, release):
            raise ValueError("engine.release: wanted numbers and dots")
        gains = numbers(metadata["engine"]["gains"], "engine.gains", most=MAX_GAIN)
        engine = Engine(release, gains)
    return EmulatorSpec(
        engine=engine,
        system=system,
        state=state,
        control=control,
        bounds=Bounds.from_json(metadata["bounds"], control.size, "bounds"),
        rest=_rest(metadata["rest"], state),
        definition=definition,
        is_tied=flag(metadata.get("tied", False), "tied"),
        gait=gait,
        substeps=substeps,
        dt=dt,
        skeleton=Skeleton.from_json(metadata["skeleton"], state.size),
        rates=tuple((position, rate) for position, rate in rates),
        strides=whole(metadata.get("strides", 1), "strides", 1, MAX_STRIDES),
    )


def _rest(values: Any, state: Layout) -> tuple[float, ...]:
    """Return the state of rest, its quaternions checked: an orientation of zeros makes poses NaN."""
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
    """Return `values` if they are increasing and below `size`."""
    rising = entries(values, "features: even", size)
    if list(rising) != sorted({*rising}):
        raise ValueError("features: even entries out of order")
    return rising


def _frame(described: dict[str, Any], state_size: int, controls: int, dt: float) -> Frame:
    """Return the frame of latent states with `state_size` entries."""
    segments = segments_from_json(described["segments"])
    if segments and sum(segment.size for segment in segments) != state_size:
        raise ValueError("frame: its segments do not fill the state")
    if any(isinstance(segment, Points | PointVelocities) for segment in segments):
        raise ValueError("frame: mass points are decoded by modes")
    if any(isinstance(segment, Driven | Lag) and segment.size != controls for segment in segments):
        raise ValueError("frame: wanted as many numbers that follow controls as there are controls")
    if any(segment.rate >= state_size - 1 for segment in segments):
        raise ValueError("frame: a rate lies outside the state")
    probes = listed(described["probes"], "frame: probes", _probe)
    if len(probes) > MAX_PROBES:
        raise ValueError(f"frame: {len(probes)} probes; wanted at most {MAX_PROBES}")
    if probes and not moves_freely(segments):
        raise ValueError("frame: probes need a root that moves freely")

    def force(row: Any, what: str) -> tuple[float, ...]:
        return numbers(row, what, controls)

    external_forces = listed(described["external_forces"], "frame: pushes", force)
    if len(external_forces) not in (0, 3):
        raise ValueError("frame: wanted pushes along three axes, or none")
    return Frame(
        segments=segments,
        probes=probes,
        dt=dt,
        has_gravity=flag(described["has_gravity"], "frame: weighs"),
        is_immersed=flag(described["is_immersed"], "frame: is_immersed"),
        external_forces=external_forces,
    )


def _with_shapes(described: Any, tensors: Mapping[str, np.ndarray], spec: EmulatorSpec) -> Skeleton:
    """Return the skeleton with the shapes of its surface."""
    first = whole(described["first"], "shapes: first", 0, MAX_NUMBERS)
    shapes = Shapes.from_tensors(tensors, first, _placement(described), spec.state.size)
    return replace(spec.skeleton, shapes=shapes)


def _placement(described: Any) -> Placement:
    entries = {}
    for name in ("position", "heading", "orientation"):
        entries[name] = whole(described[name], f"shapes: {name}", -1, MAX_NUMBERS)
    return Placement(entries["position"], entries["heading"], entries["orientation"])


def _shape_contacts(described: Any, frame: Frame, spec: EmulatorSpec) -> ShapeContacts:
    """Return the contacts of the skeleton's surface."""
    shapes = spec.skeleton.shapes
    if shapes is None:
        raise ValueError("shape contacts: of no shapes")
    constant = sum(one.size for one in frame.segments if isinstance(one, Constant))
    return ShapeContacts.from_json(
        described, shapes.mean, shapes.modes, spec.state.size - constant, spec.control.size
    )


def _contacts(described: Any, frame: Frame, spec: EmulatorSpec) -> Contacts:
    """Return the contacts of the skeleton's bones, which joints must move."""
    bones = spec.skeleton.bones
    if any(bone.binding is not None for bone in bones):
        raise ValueError("contacts: bones that follow mass points")
    return Contacts.from_json(
        described,
        kinematics=Kinematics(
            tuple(bone.link for bone in bones), tuple(bone.parent for bone in bones)
        ),
        rates=spec.rates,
        orientations=frame.orientations,
        state_size=spec.state.size,
    )


def _check_parameters(
    frame: Frame, features: Features, spec: EmulatorSpec, encoding: Encoding
) -> None:
    """Raise ValueError unless parameters are the last parts of the state, one number each, and features of the network."""
    size = encoding.layout.size
    constant = []
    for placed in place_segments(frame.segments):
        if isinstance(placed.segment, Constant):
            constant += range(placed.entries.start, placed.entries.stop)
    if constant != list(range(size - len(constant), size)):
        raise ValueError("frame: parameters that are not the last of the state")
    if isinstance(encoding, ShapeModes) and encoding.cloud.parameters != len(constant):
        raise ValueError("frame: other parameters than the shapes are of")
    for entry in constant:
        if entry not in features.plain:
            raise ValueError("features: a parameter that is not shown as it is")
        if _part_size(spec.state, entry - size + spec.state.size) != 1:
            raise ValueError("frame: a parameter that is no part of the state of one number")


def _part_size(layout: Layout, entry: int) -> int:
    """Return the size of the part that a state entry belongs to."""
    sizes = [part.size for part in layout.slices for _ in range(part.size)]
    return sizes[entry]


def _probe(row: Any, what: str) -> Probe:
    x, y, z, radius = numbers(row, what, 4, MAX_DISTANCE)
    return x, y, z, radius
