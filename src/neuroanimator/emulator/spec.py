"""The facts about its system that an emulator carries: names, units, bounds, rest, skeleton, a soft body's shapes."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import equinox as eqx
import numpy as np

from neuroanimator.appearance.shapes import Shapes
from neuroanimator.appearance.skeleton import Skeleton
from neuroanimator.files.atomic import Metadata
from neuroanimator.files.names import check_system_name
from neuroanimator.files.numbers import entries, flag, listed, number, numbers, whole
from neuroanimator.state.gait import Gait
from neuroanimator.state.layout import MAX_NUMBERS, Bounds, Layout, Pairs
from neuroanimator.state.links import UNIT_TOLERANCE
from neuroanimator.state.placement import Placement

MAX_STRIDES = 16
"""Maximum number of strides in a super step: each is compiled one by one."""

MAX_SUBSTEPS = 1000
"""Maximum number of physics steps in a super step, as in definitions and datasets."""

MIN_STEP = 1e-9
"""Minimum physics step, or interval of recordings [s]; times closer than this count as equal."""

MAX_STEP = 3600.0
"""Maximum physics step, or interval of recordings [s]."""

MAX_GAIN = 1e12
"""Maximum magnitude of a gain written into a file; larger ones are cut."""

GAINS = ("gain", "stiffness", "damping")
"""The numbers of each actuator in an `Engine`."""

RELEASE = r"[\w.+-]{1,40}"
"""Pattern of the release of a physics engine."""


class Engine(NamedTuple):
    """The release of the physics engine, and the gains it compiled, under which a system was trained.

    Another release may read other gains from the same file: a servo's `dampratio` in a chain
    of links damps less since MuJoCo 3.15.
    """

    release: str
    gains: tuple[float, ...] = ()
    """`GAINS` of each actuator, in the model's order."""

    @classmethod
    def from_json(cls, described: Any) -> Engine:
        """Return the engine whose fields `described` holds; ValueError for what is none."""
        release = described["release"]
        if not isinstance(release, str) or not re.fullmatch(RELEASE, release):
            raise ValueError("engine.release: wanted numbers and dots")
        return cls(release, numbers(described["gains"], "engine.gains", most=MAX_GAIN))


class EmulatorSpec(eqx.Module):
    """The fixed facts about an emulator's system; no weights."""

    system: str = eqx.field(static=True)
    """Name of the system."""
    state: Layout = eqx.field(static=True)
    """Named parts and units of a state (S,)."""
    control: Layout = eqx.field(static=True)
    """Named parts and units of a control (C,)."""
    bounds: Bounds = eqx.field(static=True)
    """Minimum and maximum value of every control."""
    substeps: int = eqx.field(static=True)
    """Number of physics steps in a super step."""
    dt: float = eqx.field(static=True)
    """Duration of a super step [s]."""
    skeleton: Skeleton = eqx.field(static=True)
    """Bones that draw a state."""
    rates: Pairs = eqx.field(static=True)
    """(i, j) where state entry j is the time derivative of entry i."""
    rest: tuple[float, ...] = eqx.field(static=True)
    """State of rest, the default start of motions."""
    definition: str = eqx.field(static=True, default="")
    """JSON text from which the system can be rebuilt; empty for a system that ships."""
    is_tied: bool = eqx.field(static=True, default=False)
    """Whether parts of the system are tied together, so that not every state is possible: see `System.closed`."""
    engine: Engine | None = eqx.field(static=True, default=None)
    """Engine that it was trained under; None if it is not MuJoCo, or in files of older versions."""
    gait: Gait | None = eqx.field(static=True, default=None)
    """Default gait of the system."""
    strides: int = eqx.field(static=True, default=1)
    """Number of equal strides of the network in a super step: see `Emulator.in_strides`."""

    def to_json(self) -> dict[str, Any]:
        """Return the facts by their keys in files; what a system lacks is left out, but for its gait."""
        described: dict[str, Any] = {
            "system": self.system,
            "state": self.state.to_json(),
            "control": self.control.to_json(),
            "bounds": self.bounds.to_json(),
            "definition": self.definition,
            "rest": self.rest,
            "gait": self.gait.to_json() if self.gait is not None else None,
            "substeps": self.substeps,
            "dt": self.dt,
            "skeleton": self.skeleton.to_json(),
            "rates": self.rates,
        }
        shapes = self.skeleton.shapes
        if shapes is not None:
            described["shapes"] = {"first": shapes.first} | shapes.placement.to_json()
        if self.engine is not None:
            described["engine"] = self.engine._asdict()
        if self.is_tied:
            described["tied"] = True
        if self.strides > 1:
            described["strides"] = self.strides
        return described

    @classmethod
    def from_json(cls, metadata: Metadata, shapes: Mapping[str, np.ndarray]) -> EmulatorSpec:
        """Return the facts that `to_json` wrote, its text checked by the rules of definitions, its numbers finite.

        `shapes` are the arrays of a soft body's shapes.
        """
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
        pairs = listed(
            metadata["rates"],
            "rates",
            lambda pair, what: entries(pair, what, state.size, 2),
            most=state.size,
        )
        if len({position for position, _ in pairs}) < len(pairs):
            raise ValueError("rates: an entry has two")
        gait = None
        if metadata["gait"] is not None:
            gait = Gait.from_json(metadata["gait"], control.size)
        skeleton = Skeleton.from_json(metadata["skeleton"], state.size)
        if shapes and "shapes" not in metadata:
            raise ValueError("shapes: of a body that is not soft")
        if "shapes" in metadata:
            first = whole(metadata["shapes"]["first"], "shapes: first", 0, MAX_NUMBERS)
            placement = Placement.from_json(metadata["shapes"])
            surface = Shapes.from_tensors(shapes, first, placement, state.size)
            skeleton = replace(skeleton, shapes=surface)
        return cls(
            engine=Engine.from_json(metadata["engine"]) if "engine" in metadata else None,
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
            skeleton=skeleton,
            rates=tuple((position, rate) for position, rate in pairs),
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
