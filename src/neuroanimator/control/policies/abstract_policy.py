"""What both kinds of policy share: the emulator inside, and the file, whose every name, text, shape and number is checked."""

from __future__ import annotations

import abc
from pathlib import Path
from typing import Any, ClassVar, Self, TypeVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from neuroanimator.codegen.jax_settings import compiled_quickly, keep_programs
from neuroanimator.emulator.artifact import (
    FAULTS,
    check_arrays,
    check_format,
    first_line,
    shape_tensors,
    without_shapes,
)
from neuroanimator.emulator.description import FORMAT as EMULATOR_FORMAT
from neuroanimator.emulator.description import blank, describe
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.emulator.networks import MAX_LAYER
from neuroanimator.emulator.networks.network import prefixed
from neuroanimator.emulator.tensors import emulator_leaves, to_numpy, with_tensors
from neuroanimator.errors import BadFileError
from neuroanimator.files.atomic import Metadata, read_tensors, write_tensors
from neuroanimator.files.numbers import listed, whole

PROBED_STATES = 8
"""Number of states in which a policy's controls are looked at when it is loaded: rest, and others near it."""

PROBED_SPREAD = 0.1
"""Standard deviation of these states around rest [their units]."""


class AbstractPolicy(eqx.Module):
    """A policy, and the emulator that it was trained with."""

    emulator: Emulator

    KIND: ClassVar[str]
    """Its kind in files."""
    FORMAT: ClassVar[int]
    """Version of the file format, raised whenever an older reader would misunderstand a file."""
    MAKER: ClassVar[str]
    """What retrains policies that are too old to be read."""

    @abc.abstractmethod
    def _own_leaves(self) -> dict[str, Any]:
        """Return its arrays, without the emulator's, by their names in files."""

    @abc.abstractmethod
    def _own_description(self) -> dict[str, Any]:
        """Return the metadata that, together with the tensors and the emulator's, makes up the policy."""

    @classmethod
    @abc.abstractmethod
    def _blank(cls, metadata: Metadata, emulator: Emulator) -> Self:
        """Return a policy of the described structure with zero weights."""

    @abc.abstractmethod
    def _check(self, metadata: Metadata) -> None:
        """Raise ValueError for arrays that do not belong together or cannot be used."""

    @abc.abstractmethod
    def _controls_near(self, states: Float[Array, "N S"]) -> Float[Array, "N C"]:
        """Return the controls in `PROBED_STATES` states; they must be finite."""

    def __repr__(self) -> str:
        spec = self.emulator.spec
        kind = type(self).__name__
        return f'{kind}("{spec.system}", dt {self.dt:g} s, {spec.control.size} controls)'

    @property
    def dt(self) -> float:
        """Time for which a control is held [s]."""
        return self.emulator.dt

    def _off_middle(self, share: Float[Array, "*B C"]) -> Float[Array, "*B C"]:
        """Return the controls at `share`, from -1 to 1, of the way from the middle of the bounds to either."""
        bounds = self.emulator.bounds
        middle = jnp.asarray(bounds.middle, jnp.float32)
        return middle + jnp.asarray(bounds.half, jnp.float32) * share

    def leaves(self) -> dict[str, Any]:
        """Return every array by its name in files."""
        return prefixed("emulator", emulator_leaves(self.emulator)) | self._own_leaves()

    def describe(self) -> dict[str, Any]:
        """Return the metadata that, together with the tensors, makes up the policy."""
        described = {"kind": self.KIND, "format": self.FORMAT, "emulator": describe(self.emulator)}
        return described | self._own_description()

    def save(self, path: str | Path, provenance: dict[str, Any] | None = None) -> None:
        """Write the policy and its emulator as one `.safetensors` file; `provenance` states how it was trained (any JSON)."""
        metadata = self.describe() | {"provenance": provenance or {}}
        write_tensors(Path(path), to_numpy(self.leaves()) | shape_tensors(self.emulator), metadata)


Made = TypeVar("Made", bound=AbstractPolicy)


def read_policy_file(path: Path, *kinds: type[Made]) -> tuple[Made, Metadata]:
    """Return (the policy in the file at `path`, of one of `kinds`, the file's metadata).

    Raises BadFileError with what is wrong with the file.
    """
    tensors, metadata = read_tensors(path, *[kind.KIND for kind in kinds])
    kind = {kind.KIND: kind for kind in kinds}[metadata["kind"]]
    keep_programs()
    check_format(path, metadata.get("format"), kind.FORMAT, kind.MAKER)
    emulator = metadata.get("emulator")
    emulator_format = emulator.get("format") if isinstance(emulator, dict) else None
    check_format(path, emulator_format, EMULATOR_FORMAT, kind.MAKER)
    try:
        weights, shapes = without_shapes(tensors)
        described = kind._blank(metadata, blank(metadata["emulator"], Emulator, shapes))
        policy = with_tensors(described, kind.leaves, weights)
        check_arrays(policy.emulator)
        policy._check(metadata)
        _check_controls(policy)
    except FAULTS as error:
        raise BadFileError(
            f"{path} is not a usable policy: {first_line(error)}. Make it again."
        ) from error
    if policy.emulator.definition:
        # Shipped policies have none, and the tables of definitions take long to import.
        from neuroanimator.definitions.carried import remember_folder

        remember_folder(policy.emulator.definition, path.parent)
    return policy, metadata


def _check_controls(policy: AbstractPolicy) -> None:
    """Refuse a policy whose controls are not finite in states near rest; raises ValueError."""
    rest = np.asarray(policy.emulator.rest, np.float32)
    rng = np.random.default_rng(0)
    offsets = rng.normal(size=(PROBED_STATES, len(rest))) * PROBED_SPREAD
    offsets[0] = 0
    states = jnp.asarray(rest + offsets, jnp.float32)
    controls = np.asarray(compiled_quickly(type(policy)._controls_near)(policy, states))
    if not np.isfinite(controls).all():
        raise ValueError("its controls are not finite numbers")


def read_widths(metadata: Metadata) -> tuple[int, ...]:
    """Return the sizes of a policy's hidden layers; ValueError if one is invalid."""
    return listed(metadata["widths"], "widths", _checked_width)


def _checked_width(width: Any, label: str) -> int:
    return whole(width, label, 1, MAX_LAYER)
