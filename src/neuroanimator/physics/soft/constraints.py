"""The physics of soft bodies, one element at a time, in JAX: extended position-based dynamics in small steps.

A constraint C(x) = 0 of compliance α pulls its nodes by

    Δx = w ∇C λ,    λ = -(C + γ ∇C·Δ) / ((1 + γ) Σ w |∇C|² + α/h²),    γ = α β / h

where w are inverse masses, Δ the displacement of the nodes in this small step h, and β the damping (Macklin, Müller and
Chentanez, XPBD, 2016; one pass per small step: Macklin et al., Small Steps in Physics Simulation, 2019). As h falls
this converges to springs of stiffness 1/α. Numbers are (1,) and vectors (1, 3), as `c_formula` takes them.
"""

from __future__ import annotations

import jax.numpy as jnp
from jaxtyping import Array, Float

from neuroanimator.physics.water import cross, dot, face_forces, share_under
from neuroanimator.state.shape_contacts import box_surface

TINY = 1e-18
"""Square of a length [m²] added under square roots that are divided by."""

Number = Float[Array, " 1"]
Vector = Float[Array, "1 3"]


def distance_push(
    extent: Vector,
    parting: Vector,
    inverse_mass: Number,
    length: Number,
    softness: Number,
    damping: Number,
) -> Vector:
    """Return λ∇C of a spring between two nodes, towards the second [kg·m].

    `extent` leads from the first to the second [m], `parting` is its change in this small step [m]; `inverse_mass` is the
    sum of both nodes' [1/kg], `softness` is α/h² [1/kg], `damping` is γ.
    """
    inverse = 1 / jnp.sqrt(dot(extent, extent) + TINY)
    excess = dot(extent, extent) * inverse - length
    rate = dot(extent, parting) * inverse
    push = -(excess + damping * rate) / ((1 + damping) * inverse_mass + softness)
    return (push * inverse)[:, None] * extent


def volume_slope(first: Vector, second: Vector) -> Vector:
    """Return the gradient [m²] of a tetrahedron's volume at the corner outside the plane of two edges."""
    return cross(first, second) / 6


def volume_push(
    edge: Vector,
    slope: Vector,
    weighted_squares: Number,
    volume: Number,
    softness: Number,
) -> Number:
    """Return λ of a tetrahedron's volume: `slope` is that of the corner at the end of `edge`, `weighted_squares` Σ w |∇C|²."""
    return -(dot(edge, slope) - volume) / (weighted_squares + softness)


def fall(velocity: Vector, wind: Vector, gravity: Vector, drag: Number, time: Number) -> Vector:
    """Return the velocity [m/s] after `time` [s] of weight, and of air that carries nodes along at the rate `drag` [1/s]."""
    return (velocity + time[:, None] * (gravity + drag[:, None] * wind)) / (1 + time * drag)[
        :, None
    ]


def air_push(right: Vector, up: Vector, wind: Vector, density: Number, limit: Number) -> Vector:
    """Return the impulse over time [N] of air on a triangle between two of its edges: along its normal alone.

    `wind` is the air's velocity over the triangle's [m/s], `density` half the air's times its drag coefficient
    [kg/m³]. Pressure grows with the square of the speed up to `limit` [m/s].
    """
    normal = cross(right, up)  # of twice the area's length
    inverse = 1 / jnp.sqrt(dot(normal, normal) + TINY)
    speed = dot(normal, wind) * inverse
    speed = jnp.clip(speed, -limit, limit)
    size = jnp.maximum(speed, -speed)
    return (density * speed * size / 2)[:, None] * normal


def water_push(
    right: Vector,
    up: Vector,
    flow: Vector,
    height: Number,
    drag: Number,
    surface: Number,
    depth: Number,
) -> Vector:
    """Return the force of water on a triangle between two of its edges [N]; see `physics.water`, which names the numbers."""
    return face_forces(drag, right, up, flow, share_under(height, surface, depth))


def lifted(
    velocity: Vector,
    height: Number,
    gravity: Vector,
    lift: Number,
    drag: Number,
    surface: Number,
    depth: Number,
    time: Number,
) -> Vector:
    """Return the velocity [m/s] of a node after `time` [s] of the lift and the damping of water."""
    wet = share_under(height, surface, depth)
    risen = velocity - (time * lift * wet)[:, None] * gravity
    return risen / (1 + time * drag * wet)[:, None]


def capsule_push(
    position: Vector,
    moved: Vector,
    start: Vector,
    along: Vector,
    start_moved: Vector,
    along_moved: Vector,
    radius: Number,
    friction: Number,
) -> Vector:
    """Return the displacement that moves a node out of a capsule, with friction [m]; zero for a node outside.

    The capsule's axis leads from `start` by `along` [m], zero for a sphere. `moved` is the displacement of the node in
    this small step, `start_moved` and `along_moved` are the changes of the axis.
    """
    share = jnp.clip(dot(position - start, along) / (dot(along, along) + TINY), 0, 1)[:, None]
    outward = position - start - share * along
    slip = moved - start_moved - share * along_moved
    inverse = 1 / jnp.sqrt(dot(outward, outward) + TINY)
    depth = jnp.maximum(radius - dot(outward, outward) * inverse, 0)
    return _contact(depth, inverse[:, None] * outward, slip, friction)


def box_push(
    position: Vector,
    moved: Vector,
    centre: Vector,
    ahead: Vector,
    left: Vector,
    up: Vector,
    half: Vector,
    centre_moved: Vector,
    turned: Vector,
    margin: Number,
    friction: Number,
) -> Vector:
    """Return the displacement that moves a node out of a box, rounded by `margin` [m]; see `capsule_push`.

    `half` is half its size along its axes `ahead`, `left` and `up` [m], `turned` [rad] its rotation in this small step.
    """
    away = position - centre
    axes = (ahead, left, up)
    halves = [half[:, axis] for axis in range(3)]
    distance, outward = box_surface([dot(away, axis) for axis in axes], halves, TINY)
    depth = jnp.maximum(margin - distance, 0)
    normal = outward[0][:, None] * ahead + outward[1][:, None] * left + outward[2][:, None] * up
    return _contact(depth, normal, moved - centre_moved - cross(turned, away), friction)


def plane_push(
    position: Vector,
    moved: Vector,
    point: Vector,
    normal: Vector,
    point_moved: Vector,
    margin: Number,
    friction: Number,
) -> Vector:
    """Return the displacement that moves a node to `margin` [m] above a plane, if it is below; see `capsule_push`."""
    depth = jnp.maximum(margin - dot(position - point, normal), 0)
    return _contact(depth, normal, moved - point_moved, friction)


def _contact(depth: Number, normal: Vector, slip: Vector, friction: Number) -> Vector:
    """Return the push out by `depth` [m] along `normal`, with Coulomb friction against `slip` [m]."""
    tangent = slip - dot(slip, normal)[:, None] * normal
    inverse = 1 / jnp.sqrt(dot(tangent, tangent) + TINY)
    held = jnp.minimum(friction * depth * inverse, 1)
    return depth[:, None] * normal - held[:, None] * tangent
