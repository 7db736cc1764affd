"""Parameters of a mass-spring body: their targets, and the numbers of the body that follow from them.

`spring/muscle/stiffness` is the stiffness of the group `muscle` of its springs; `TARGETS` lists them all. A body that
grows in length keeps its density, the stiffness of its springs and the ratio of its buoyancy.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from copy import copy
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from neuroanimator.definitions.body import BodyDefinition
from neuroanimator.definitions.parts import ParameterTable
from neuroanimator.errors import ArgumentError
from neuroanimator.files.names import check_known
from neuroanimator.physics.deformable.body import Body
from neuroanimator.physics.deformable.checks import check_steps
from neuroanimator.physics.deformable.mirror import mirror_of
from neuroanimator.physics.state_parts import parameter_from_table
from neuroanimator.state.arrays import AnyArray
from neuroanimator.state.parameters import Parameter, nominal_values
from neuroanimator.text import quoted

LENGTH = "body/length"
DENSITY_FACTOR = "body/density_factor"
STIFFNESS_FACTOR = "spring/stiffness_factor"
DAMPING_FACTOR = "spring/damping_factor"
FACE_DRAG = "water/face_drag"
DRAG = "water/drag"

MAX_CORNERS = 8
"""Maximum number of parameters whose ends are tried in all combinations; with more, each end is tried alone."""


class BodyAttribute(NamedTuple):
    """The last part of a target: an attribute of the elements that have it."""

    unit: str
    may_be_zero: bool


ATTRIBUTES = {
    "length": BodyAttribute("m", may_be_zero=False),
    "density_factor": BodyAttribute("1", may_be_zero=False),
    "stiffness_factor": BodyAttribute("1", may_be_zero=False),
    "damping_factor": BodyAttribute("1", may_be_zero=True),
    "stiffness": BodyAttribute("N/m", may_be_zero=False),
    "damping": BodyAttribute("N·s/m", may_be_zero=True),
    "face_drag": BodyAttribute("kg/(m²·s)", may_be_zero=True),
    "drag": BodyAttribute("1/s", may_be_zero=True),
}


def own_values(body: Body) -> dict[str, float]:
    """Return the body's own value of each target: length along X, factors of one, groups of springs, water."""
    own = {DENSITY_FACTOR: 1.0, STIFFNESS_FACTOR: 1.0, DAMPING_FACTOR: 1.0}
    length = float(np.ptp(body.positions[:, 0]))
    if length > 0:
        own[LENGTH] = length
    for group in dict.fromkeys(body.spring_groups):
        spring = body.spring_groups.index(group)
        own[f"spring/{group}/stiffness"] = float(body.stiffness[spring])
        own[f"spring/{group}/damping"] = float(body.damping[spring])
    if body.water is not None:
        own[FACE_DRAG] = body.water.face_drag
        own[DRAG] = body.water.drag
    return own


def parameters_of(tables: Mapping[str, ParameterTable], body: Body) -> tuple[Parameter, ...]:
    """Return the parameters that `tables` describe.

    Raises ArgumentError for a target that the body does not have, and for impossible values.
    """
    own = own_values(body)
    parameters = []
    for name, table in tables.items():
        where = f"parameters.{name}"
        check_known([table.sets], sorted(own), "target", f"{where}.sets")
        for other, earlier in tables.items():
            if other < name and earlier.sets == table.sets:
                raise ArgumentError(
                    f"{where}.sets: {quoted(other)} sets {table.sets}, too. Leave one out."
                )
        attribute = ATTRIBUTES[table.sets.rpartition("/")[2]]
        low = table.range[0]
        if low < 0 or (low == 0 and not attribute.may_be_zero):
            wanted = "at least 0" if attribute.may_be_zero else "above 0"
            raise ArgumentError(
                f"{where}.range: wanted values {wanted}, got {low:g} {attribute.unit}. Narrow the range."
            )
        parameters.append(parameter_from_table(name, table, attribute.unit, own[table.sets]))
    return tuple(parameters)


def check_family(definition: BodyDefinition, body: Body, parameters: tuple[Parameter, ...]) -> None:
    """Refuse ranges whose ends make a body unstable at its steps, or its left and right differ."""
    for values in _corners(parameters):
        corner = body_at(body, values)
        try:
            check_steps(definition, corner)
            mirror_of(definition, corner)
        except ArgumentError as error:
            named = zip(parameters, values.tolist(), strict=True)
            shown = ", ".join(f"{parameter.name} = {value:g}" for parameter, value in named)
            raise ArgumentError(
                f"parameters: with {shown}: {error} Or narrow the range."
            ) from error


def _corners(parameters: tuple[Parameter, ...]) -> list[Float[np.ndarray, " Q"]]:
    """Return the values at the ends of the ranges: in all combinations, or one by one for many parameters."""
    if not parameters:
        return []
    ends = [(parameter.low, parameter.high) for parameter in parameters]
    if len(ends) <= MAX_CORNERS:
        return [np.array(corner) for corner in itertools.product(*ends)]
    corners = []
    for place, two_ends in enumerate(ends):
        for end in two_ends:
            values = nominal_values(parameters)
            values[place] = end
            corners.append(values)
    return corners


def body_at(body: Body, values: Float[AnyArray, "Q ..."]) -> Body:
    """Return the body whose parameters have these values: itself if none vary.

    Further axes of `values` come last in all that depends on them, as in the physics; JAX can trace it. The shares of
    mass points in lift and faces, and the load on the ground, are those of `body`.
    """
    if not body.varied:
        return body
    xp = values.__array_namespace__()
    own = own_values(body)
    settings = own | dict(zip(body.varied, values, strict=True))
    zero = 0 * values[0]
    growth = zero + settings.get(LENGTH, 1.0) / own.get(LENGTH, 1.0)
    density = zero + settings[DENSITY_FACTOR]
    batch = (1,) * (values.ndim - 1)

    def column(numbers: Float[np.ndarray, " N"]) -> AnyArray:
        """Return numbers of mass points or springs as an array that multiplies parameters."""
        return xp.asarray(numbers).reshape(-1, *batch)

    def of_groups(attribute: str) -> AnyArray:
        """Return the attribute of every spring."""
        groups = list(dict.fromkeys(body.spring_groups))
        rows = [zero + settings[f"spring/{group}/{attribute}"] for group in groups]
        numbers = [groups.index(group) for group in body.spring_groups]
        return xp.stack(rows)[np.array(numbers)]

    extents = body.extents
    stiffness, damping, lengths = spring_numbers(
        along=column(extents[:, 0] ** 2),
        across=column(extents[:, 1] ** 2 + extents[:, 2] ** 2),
        force_density=column(body.force_densities),
        stiffness=of_groups("stiffness"),
        damping=of_groups("damping"),
        stiffness_factor=settings[STIFFNESS_FACTOR],
        damping_factor=settings[DAMPING_FACTOR],
        growth=growth,
        density=density,
    )
    stretch = xp.stack([growth, zero + 1, zero + 1])
    numbers = {
        "positions": body.positions.reshape(*body.positions.shape, *batch) * stretch,
        "masses": mass_of_point(column(body.masses), growth, density),
        "stiffness": stiffness,
        "damping": damping,
        "lengths": lengths,
        "varied": (),
    }
    if body.water is not None:
        numbers["water"] = replace(body.water, face_drag=settings[FACE_DRAG], drag=settings[DRAG])
    return with_numbers(body, **numbers)


def with_numbers(body: Body, **numbers: Any) -> Body:
    """Return `body` with other numbers; those that follow from them at rest are not recomputed."""
    changed = copy(body)
    for name, number in numbers.items():
        object.__setattr__(changed, name, number)
    return changed


def spring_numbers(
    along: AnyArray,
    across: AnyArray,
    force_density: AnyArray,
    stiffness: AnyArray,
    damping: AnyArray,
    stiffness_factor: AnyArray,
    damping_factor: AnyArray,
    growth: AnyArray,
    density: AnyArray,
) -> tuple[AnyArray, AnyArray, AnyArray]:
    """Return stiffness [N/m], damping [N·s/m] and length without force [m] of springs in a body that grows along X.

    `along` and `across` are the squares of their extents at rest before growth [m²]. Springs carry the body's weight and
    lift by the same force densities in every stretched shape (Schek 1974), which grow with the mass alone.
    """
    varied = stiffness * stiffness_factor
    square = along * growth**2 + across
    spans = square.__array_namespace__().sqrt(square)
    lengths = spans * (1 - growth * density * force_density / varied)
    return varied, damping * damping_factor, lengths


def mass_of_point(mass: AnyArray, growth: AnyArray, density: AnyArray) -> AnyArray:
    """Return the mass [kg] of a mass point of `mass` in a body that grows along X."""
    return mass * growth * density
