"""An emulator written down: everything but its arrays, as JSON, and the blank emulator made from it.

Each part writes and reads itself; here are the keys of the parts, and what must hold between them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, TypeVar

import numpy as np

from neuroanimator.appearance.skeleton import kinematics_of
from neuroanimator.emulator.arrays import zeros
from neuroanimator.emulator.domain import Domain
from neuroanimator.emulator.encoding import PARTNERS, Encoding, StateEncoding
from neuroanimator.emulator.error_bounds import ErrorBounds
from neuroanimator.emulator.features import Features
from neuroanimator.emulator.networks import blank_network, network_to_json
from neuroanimator.emulator.normaliser import Normaliser
from neuroanimator.emulator.shape_modes import ShapeModes
from neuroanimator.emulator.spec import EmulatorSpec
from neuroanimator.emulator.super_step import SuperStep
from neuroanimator.emulator.trust import TrustMeter
from neuroanimator.emulator.verdict import ValidationErrors
from neuroanimator.files.atomic import Metadata
from neuroanimator.files.numbers import flag
from neuroanimator.state.body_frame import Frame
from neuroanimator.state.contacts import Contacts
from neuroanimator.state.segments import Constant, place_segments
from neuroanimator.state.shape_contacts import ShapeContacts

FORMAT = 5
"""Version of the file format, raised whenever an older reader would misunderstand a file."""

Made = TypeVar("Made", bound=SuperStep)
"""Class of the emulator made from a description."""


def describe(emulator: SuperStep) -> dict[str, Any]:
    """Return the metadata that, together with the tensors, makes up the emulator.

    Parts that an emulator lacks are left out, so that older files keep their contents.
    """
    frame = emulator.frame
    described = {
        "kind": "emulator",
        "format": FORMAT,
        **emulator.spec.to_json(),
        "modes": emulator.encoding.to_json(),
        "frame": frame.to_json(),
        "features": emulator.features.to_json(),
        "network": network_to_json(emulator.network),
    }
    parts = {
        "contacts": frame.contacts,
        "shape_contacts": frame.shape_contacts,
        "trust": emulator.meter,
        "errors": emulator.calibration,
    }
    described |= {key: part.to_json() for key, part in parts.items() if part is not None}
    if emulator.validation is not None:
        described["validation"] = True
        if emulator.validation.window is not None:
            described["validation_window"] = True
    return described


def blank(
    metadata: Metadata, kind: type[Made], shapes: Mapping[str, np.ndarray] | None = None
) -> Made:
    """Return an emulator of the described structure with zero weights; `shapes` are the arrays of a soft body's shapes.

    Raises one of `artifact.FAULTS` for anything invalid.
    """
    spec = EmulatorSpec.from_json(metadata, shapes or {})
    controls = spec.control.size
    encoding = StateEncoding(spec.state)
    if metadata["modes"] is not None and PARTNERS in metadata["modes"]:
        encoding = StateEncoding.from_json(metadata["modes"], spec.state, controls)
    elif metadata["modes"] is not None:
        encoding = ShapeModes.from_json(metadata["modes"], spec.state.size, controls)
    latent_size = encoding.layout.size
    # the frame, with what a body may touch
    frame = Frame.from_json(metadata["frame"], latent_size, controls, spec.dt / spec.strides)
    if "contacts" in metadata:
        frame = replace(frame, contacts=_contacts(metadata["contacts"], frame, spec))
    if "shape_contacts" in metadata:
        contacts = _shape_contacts(metadata["shape_contacts"], frame, spec)
        frame = replace(frame, shape_contacts=contacts)
    # the network, from its features to changes
    others = frame.local_size + frame.control_size(controls)
    changes = frame.change_size(latent_size)
    features = Features.blank(metadata["features"], latent_size, others)
    feature_count = len(features.plain) + others
    _check_parameters(frame, features, spec, encoding)
    network = blank_network(metadata["network"], features.sizes(others), changes)
    # what is known of its errors
    meter = None
    if "trust" in metadata:
        meter = TrustMeter.blank(metadata["trust"], network)
    calibration = None
    if "errors" in metadata:
        calibration = ErrorBounds.blank(metadata["errors"])
    validation = None
    if flag(metadata.get("validation", False), "validation"):
        has_window = flag(metadata.get("validation_window", False), "validation_window")
        validation = ValidationErrors.blank(has_window=has_window)
    return kind(
        frame=frame,
        features=features,
        normaliser=Normaliser.blank(feature_count, changes),
        network=network,
        domain=Domain(zeros(feature_count), zeros(feature_count)),
        spec=spec,
        encoding=encoding,
        meter=meter,
        calibration=calibration,
        validation=validation,
    )


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
        kinematics=kinematics_of(bones),
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
            constant += placed.indices
    if constant != list(range(size - len(constant), size)):
        raise ValueError("frame: parameters that are not the last of the state")
    if isinstance(encoding, ShapeModes) and encoding.cloud.parameters != len(constant):
        raise ValueError("frame: other parameters than the shapes are of")
    sizes = [part.size for part in spec.state.slices for _ in range(part.size)]
    for entry in constant:
        if entry not in features.plain:
            raise ValueError("features: a parameter that is not shown as it is")
        if sizes[entry - size] != 1:
            raise ValueError("frame: a parameter that is no part of the state of one number")
