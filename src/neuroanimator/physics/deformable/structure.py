"""The meaning of a deformable body's state vector: its named slices, and the structure an emulator may use."""

from __future__ import annotations

import numpy as np

from neuroanimator.definitions.body import BodyDefinition, control_names
from neuroanimator.physics.deformable.body import Body
from neuroanimator.physics.deformable.body_parameters import body_at
from neuroanimator.physics.deformable.build import group_numbers
from neuroanimator.physics.deformable.mirror import mirror_of
from neuroanimator.state.layout import Layout, Slice
from neuroanimator.state.parameters import Parameter, nominal_values
from neuroanimator.state.reference_shape import Cloud
from neuroanimator.state.segments import Constant, Lag, Points, PointVelocities, Segment
from neuroanimator.state.structure import BodyGroup, Probe, Structure


def state_layout(
    definition: BodyDefinition, body: Body, parameters: tuple[Parameter, ...]
) -> Layout:
    """Return the state's slices: positions of all mass points, their velocities, muscle activations, parameters."""
    muscles = control_names(definition)[: body.muscles.shape[1]]
    positions = [Slice(name, 3, "m") for name in body.names]
    velocities = [Slice(f"{name}.velocity", 3, "m/s") for name in body.names]
    activations = [Slice(f"{name}.contraction", 1, "1") for name in muscles]
    constant = [parameter.slice for parameter in parameters]
    return Layout((*positions, *velocities, *activations, *constant))


def structure_of(
    definition: BodyDefinition, body: Body, parameters: tuple[Parameter, ...]
) -> Structure:
    """Return the structure an emulator may use; ArgumentError for invalid groups or an invalid mirror."""
    size = 3 * len(body.masses)
    muscles = body.muscles.shape[1]
    segments: list[Segment] = [Points(size=size, rate=size), PointVelocities(size=size)]
    if muscles:
        segments.append(Lag(size=muscles, time_constant=body.time_constant))
    if parameters:
        segments.append(Constant(size=len(parameters)))
    return Structure(
        angles=(),
        rates=tuple((entry, size + entry) for entry in range(size)),
        plain=(),
        segments=tuple(segments),
        cloud=_cloud(body, parameters),
        has_gravity=body.has_gravity,
        is_immersed=body.water is not None and body.ground is None,
        mirror=mirror_of(definition, body),
        probes=_probes(definition, body),
        groups=_groups(definition, body),
        external_forces=_external_forces(body),
    )


def _cloud(body: Body, parameters: tuple[Parameter, ...]) -> Cloud:
    """Return the mass points at rest, and the derivatives of their positions by the parameters."""
    nominal = nominal_values(parameters)
    cloud = Cloud.of(body_at(body, nominal).positions, body.masses)
    slopes = []
    for place, parameter in enumerate(parameters):
        ends = []
        for end in (parameter.low, parameter.high):
            values = nominal.copy()
            values[place] = end
            ends.append(body_at(body, values).positions)
        slopes.append((ends[1] - ends[0]) / (parameter.high - parameter.low))
    if not slopes:
        return cloud
    return cloud.of_family(nominal, np.stack(slopes))


def _probes(definition: BodyDefinition, body: Body) -> tuple[Probe, ...]:
    """Return the probes relative to the centroid; their radii stand for the height of the surface."""
    centre = body.masses @ body.positions / body.masses.sum()
    level = 0.0
    if body.water is not None and body.water.surface is not None:
        level = body.water.surface
    offsets = np.array(definition.probes).reshape(-1, 3) - centre
    return tuple((x, y, z, level) for x, y, z in offsets.tolist())


def _groups(definition: BodyDefinition, body: Body) -> tuple[BodyGroup, ...]:
    """Return the groups of mass points, each with the muscles that end in it."""
    shortens = np.abs(body.muscles) > 0
    groups = []
    for name, points in group_numbers(definition).items():
        has_end_here = np.isin(body.springs, points).any(axis=1)
        muscles = np.flatnonzero(shortens[has_end_here].any(axis=0))
        groups.append(BodyGroup(name, points, tuple(muscles.tolist())))
    return tuple(groups)


def _external_forces(body: Body) -> tuple[tuple[float, ...], ...]:
    """Return the force per control, axis by axis; empty if controls are not such forces."""
    if not body.external_forces.any():
        return ()
    return tuple(tuple(row) for row in body.external_forces.tolist())
