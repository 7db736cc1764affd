"""The emulator: frame → features → normaliser → network → one super step."""

from __future__ import annotations

from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from numpy.typing import ArrayLike

from neuroanimator.appearance.skeleton import Skeleton
from neuroanimator.emulator.arrays import as_jax
from neuroanimator.emulator.compiled import Step, call_compiled
from neuroanimator.emulator.features import Features
from neuroanimator.emulator.networks.network import Network
from neuroanimator.emulator.normaliser import Normaliser
from neuroanimator.emulator.shape_modes import Modes
from neuroanimator.errors import ArgumentError, DivergedError
from neuroanimator.state.body_frame import Frame
from neuroanimator.state.gait import Gait
from neuroanimator.state.layout import Bounds, Layout
from neuroanimator.state.rotation import Numbers
from neuroanimator.zoo import find_emulator, is_name

UNROLL = 4
"""Super steps compiled into one loop body: 10 % faster than one; eight gain nothing more."""


MAX_MAGNITUDE = 1e6
"""Of a state: beyond it a super step's change is lost in the rounding of float32."""

COVERED_MARGIN = 0.02
"""Share of its range by which a number may leave it and still count as covered: samples seldom touch its ends."""

KEPT_MARGIN = 0.1
"""Share of its range by which a predicted number may leave it: further out the network says nothing of worth."""


class Domain(eqx.Module):
    """The range of every plain feature (speeds, the frame's numbers, controls) seen in training."""

    low: Float[Array, " K"]
    high: Float[Array, " K"]

    def covers(self, plain: Numbers) -> Numbers:
        """Return (...) whether every entry of `plain` (..., k), the first k features, lies in the range or near it."""
        xp = plain.__array_namespace__()
        low, high = self.widened(COVERED_MARGIN, slice(plain.shape[-1]))
        return xp.all((plain >= xp.asarray(low)) & (plain <= xp.asarray(high)), axis=-1)

    def widened(self, margin: float, entries: slice) -> tuple[Array, Array]:
        """Return the ends of the range of some `entries`, further apart by `margin` times the range on each side."""
        low = self.low[entries]
        high = self.high[entries]
        room = margin * (high - low)
        return low - room, high + room

    def clip(self, plain: Float[Array, " K"]) -> Float[Array, " K"]:
        """Return `plain` with every entry brought into the range: what the network never saw, it is not shown."""
        return jnp.clip(plain, self.low, self.high)


class EmulatorSpec(eqx.Module):
    """What an emulator stands for: fixed facts, no weights."""

    system: str = eqx.field(static=True)
    state: Layout = eqx.field(static=True)
    control: Layout = eqx.field(static=True)
    bounds: Bounds = eqx.field(static=True)
    """Of the controls."""
    substeps: int = eqx.field(static=True)
    dt: float = eqx.field(static=True)
    """Time one super step covers [s]."""
    skeleton: Skeleton = eqx.field(static=True)
    rates: tuple[tuple[int, int], ...] = eqx.field(static=True)
    """(i, j) where state entry j is the time derivative of entry i."""
    rest: tuple[float, ...] = eqx.field(static=True)
    """A state of rest, where motions begin if nothing else is said."""
    definition: str = eqx.field(static=True, default="")
    """JSON text the system can be made from again; empty for one that comes with the package."""
    gait: Gait | None = eqx.field(static=True, default=None)
    """How the system moves along if nothing else is said."""


class Emulator(eqx.Module):
    """A network that leaps a system one super step ahead: s + change(s, u) (SIGGRAPH 98, eq. 7)."""

    frame: Frame
    features: Features
    normaliser: Normaliser
    network: Network
    domain: Domain
    spec: EmulatorSpec
    modes: Modes | None = None
    """Of a deformable body: the few numbers the super step is made in."""

    @property
    def system(self) -> str:
        """Name of the system."""
        return self.spec.system

    @property
    def state(self) -> Layout:
        """Named parts and units of a state (S,)."""
        return self.spec.state

    @property
    def control(self) -> Layout:
        """Named parts and units of a control (C,)."""
        return self.spec.control

    @property
    def bounds(self) -> Bounds:
        """Lowest and highest value of every control."""
        return self.spec.bounds

    @property
    def rest(self) -> Float[np.ndarray, " S"]:
        """A state of rest, as a new array: motions begin there if nothing else is said."""
        return np.array(self.spec.rest)

    @property
    def dt(self) -> float:
        """Time one super step covers [s]."""
        return self.spec.dt

    @property
    def substeps(self) -> int:
        """Physics steps one super step stands for."""
        return self.spec.substeps

    @property
    def skeleton(self) -> Skeleton:
        """Bones to draw a state with."""
        return self.spec.skeleton

    @property
    def rates(self) -> tuple[tuple[int, int], ...]:
        """(i, j) where state entry j is the time derivative of entry i."""
        return self.spec.rates

    @property
    def gait(self) -> Gait | None:
        """How the system moves along if nothing else is said; None where it has no such way."""
        return self.spec.gait

    @property
    def definition(self) -> str:
        """JSON text the system can be made from again; empty for one that comes with the package."""
        return self.spec.definition

    @property
    def step(self) -> Step:
        """`step(state (S,), control (C,))` is the state (S,) `dt` seconds later: see `Step.__call__`.

        A function that can be called from Python, where it is compiled at the first call, and given to `jax.jit`,
        `jax.grad` and `jax.vmap`.
        """
        spec, kind = self.spec, self.normaliser.change_scale.dtype
        return Step(step, self, spec.state, spec.control, kind)

    def step_latent(
        self, latent: Float[Array, " I"], control: Float[Array, " C"]
    ) -> Float[Array, " I"]:
        """Return `step` in the numbers it is made in: those of `encode` and `encode_control`.

        A deformable body's shape and speed, and the numbers a network is shown of any other state, are kept within
        what training showed.
        """
        following = self.step_latent_unbounded(latent, control)
        return self._kept(following) if self.modes is None else self.modes.bounded(following)

    def _kept(self, state: Float[Array, " S"]) -> Float[Array, " S"]:
        """Return `state` (S,) with the entries a network sees as they are brought into the range of training."""
        entries = self.features.plain
        if not entries:
            return state
        low, high = self.domain.widened(KEPT_MARGIN, slice(len(entries)))
        seen = self.features.plain_of(state)
        return self.features.with_plain(state, jnp.clip(seen, low, high))

    def step_latent_unbounded(
        self, latent: Float[Array, " I"], control: Float[Array, " C"]
    ) -> Float[Array, " I"]:
        """Return what the network makes of `latent`: `step_latent` before anything is kept within bounds."""
        plain = self.normaliser.forward(self.domain.clip(self.seen(latent, control)))
        change = self.normaliser.inverse(self.network(*self.features.streams(latent, plain)))
        return self.frame.apply(latent, change, control)

    def rest_streams(self) -> tuple[Float[Array, " O"], Float[Array, " E"]]:
        """Return what the network sees at rest without control; left and right are alike there, to the last bit."""
        latent = self.encode(self.rest)
        control = self.encode_control(self.bounds.idle)
        seen = jnp.asarray(self.seen(latent, control), jnp.float32)
        plain = self.normaliser.forward(self.domain.clip(seen))
        odd, even = self.features.streams(jnp.asarray(latent, jnp.float32), plain)
        return (jnp.zeros_like(odd), even) if self.features.is_odd else (odd, even)

    def at_rest(self, streams: tuple[Float[Array, " O"], Float[Array, " E"]]) -> Emulator:
        """Return the emulator that stays at rest: what the network says of it, `rest_streams`, is taken away.

        Only for systems that keep still there. It costs nothing: the mean change takes it up.
        """
        said = self.normaliser.change_scale * self.network(*streams)
        return eqx.tree_at(lambda emulator: emulator.normaliser.change_mean, self, 0.0 - said)

    def encode(self, state: Numbers) -> Numbers:
        """Return (..., I) the numbers in which the super step is made: of a deformable body few, else the state."""
        return state if self.modes is None else self.modes.encode(state)

    def decode(self, latent: Numbers) -> Numbers:
        """Return the states (..., S) of `latent` (..., I)."""
        return latent if self.modes is None else self.modes.decode(latent)

    def encode_control(self, control: Numbers) -> Numbers:
        """Return the controls (..., C) as `step_latent` takes them."""
        return control if self.modes is None else self.modes.encode_control(control)

    def encode_motion(
        self, state: ArrayLike, controls: ArrayLike
    ) -> tuple[Float[Array, " I"], Float[Array, "*T C"]]:
        """Return a start (S,) and the controls (..., C) from there on as `step_latent` takes them, in float32."""
        return self.encode(as_jax(state)), self.encode_control(as_jax(controls))

    def seen(self, latent: Numbers, control: Numbers) -> Numbers:
        """Return (..., K) what the network sees besides sines and cosines, not yet normalised: no place, no heading."""
        return self.features.plain_of(
            latent, self.frame.local(latent), self.frame.seen_control(latent, control)
        )

    def plain_of(self, state: Numbers, control: Numbers) -> Numbers:
        """Return (..., K) what the network sees of a state (..., S) and a control (..., C), not yet normalised."""
        return self.seen(self.encode(state), self.encode_control(control))

    def rollout(
        self, state: ArrayLike, controls: ArrayLike, *, may_diverge: bool = False
    ) -> Float[Array, "*B T+1 S"]:
        """Return the trajectory from `state` (S,) under `controls` (T, C), the start included.

        A batch is `state` (B, S) with `controls` (B, T, C). With `may_diverge`, numbers that are not finite are
        returned where the motion comes to that.

        Raises ArgumentError for wrong shapes, for numbers that are not finite or larger than `MAX_MAGNITUDE`, and
        for states no motion follows from; DivergedError where a motion ends in numbers that are not finite.
        """
        state, controls = self._checked(state, controls)
        if not controls.shape[-2]:
            return state[..., None, :]
        found = call_compiled(
            _quick_rollouts if state.ndim == 2 else _quick_rollout, self, state, controls
        )
        if not may_diverge:
            self._check_finite(np.asarray(found))
        return found

    def _check_finite(self, trajectory: np.ndarray) -> None:
        """Refuse a trajectory (..., T+1, S) with numbers that are not finite, by the first of them."""
        is_broken = ~np.isfinite(trajectory)
        if not is_broken.any():
            return
        *_, step, entry = np.argwhere(is_broken)[np.argmin(np.argwhere(is_broken)[:, -2])]
        name = self.spec.state.names[entry]
        if step <= 1:
            raise ArgumentError(
                f"state: no motion follows from it: after one super step {name} is not finite. Give a state that the "
                "system can be in, such as its rest; `covers` says which the emulator knows."
            )
        raise DivergedError(
            f"The motion diverged: {name} is not finite from super step {step} on. Start nearer to what the emulator "
            "was trained on (`covers` says what that is), or train it longer."
        )

    def covers(self, state: ArrayLike, control: ArrayLike) -> bool:
        """Return whether `state` (S,) with `control` (C,) lies in the range this emulator was trained on.

        Controls are covered between their bounds. What is not finite is covered nowhere.

        Raises ArgumentError for wrong shapes.
        """
        state = self.spec.state.check_shape(state, "state")
        control = self.spec.control.check_shape(control, "control")
        if not (np.abs(state) <= MAX_MAGNITUDE).all() or not np.isfinite(control).all():
            return False
        if not self.spec.bounds.contain(control):
            return False
        with np.errstate(all="ignore"):  # huge numbers overflow on their way, and are not covered
            return bool(self.covers_encoded(self.encode(state)))

    def covers_encoded(self, latent: Numbers) -> Numbers:
        """Return (...) the same of states in the numbers of `encode` (..., I), whatever the control; inside jit too."""
        return self.domain.covers(self.features.plain_of(latent, self.frame.local(latent)))

    def save(self, path: str | Path) -> None:
        """Write the emulator as one `.safetensors` file."""
        from neuroanimator.emulator.artifact import save

        save(self, Path(path))

    @classmethod
    def load(cls, path: str | Path) -> Emulator:
        """Return the emulator in the file at `path`, or the one that ships under the name `path`: "fish-50".

        A name has no folder and no suffix. BadFileError says what is wrong with a file, and lists the names.
        """
        from neuroanimator.emulator.artifact import load

        file = find_emulator(path) if isinstance(path, str) and is_name(path) else Path(path)
        return load(file)

    def __repr__(self) -> str:
        spec = self.spec
        kind = type(self.network).__name__.lower()
        widths = "x".join(map(str, self.network.widths))
        return (
            f'Emulator("{spec.system}", {spec.substeps} substeps, dt {spec.dt:g} s, '
            f"{spec.state.size} states, {spec.control.size} controls, {kind} {widths})"
        )

    def _checked(self, state: ArrayLike, controls: ArrayLike) -> tuple[Array, Array]:
        state = self.spec.state.check(state, "state")
        controls = self.spec.control.check(controls, "control")
        if (
            state.ndim not in (1, 2)
            or controls.ndim != state.ndim + 1
            or state.shape[:-1] != controls.shape[:-2]
        ):
            raise ArgumentError(
                f"state and controls: wanted (S,) with (T, C) or (B, S) with (B, T, C), "
                f"came {state.shape} with {controls.shape}."
            )
        too_large = np.abs(state) > MAX_MAGNITUDE
        if too_large.any():
            index = tuple(np.argwhere(too_large)[0])
            raise ArgumentError(
                f"state: {self.spec.state.names[index[-1]]} is {state[index]:g}; wanted a magnitude of at most "
                f"{MAX_MAGNITUDE:g}. Start nearer to where you look."
            )
        kind = self.normaliser.change_scale.dtype
        return as_jax(state, kind), as_jax(controls, kind)


def step(
    emulator: Emulator, state: Float[Array, " S"], control: Float[Array, " C"]
) -> Float[Array, " S"]:
    """Return the state one super step after `state`. For use inside jit, grad and vmap."""
    latent = emulator.encode(state)
    return emulator.decode(emulator.step_latent(latent, emulator.encode_control(control)))


def rollout(
    emulator: Emulator,
    state: Float[Array, " S"],
    controls: Float[Array, "T C"],
    *,
    unroll: int = UNROLL,
) -> Float[Array, "T+1 S"]:
    """Return the trajectory from `state`, start included. For use inside jit, grad and vmap."""
    latent = rollout_latent(
        emulator, emulator.encode(state), emulator.encode_control(controls), unroll=unroll
    )
    return jnp.concatenate([state[None], emulator.decode(latent)])


def rollout_latent(
    emulator: Emulator,
    latent: Float[Array, " I"],
    controls: Float[Array, "T C"],
    *,
    is_bounded: bool = True,
    unroll: int = UNROLL,
) -> Float[Array, "T I"]:
    """Return the trajectory after `latent`, all in the numbers in which the super step is made.

    Training follows the network alone: what bounds do to a stray body teaches nothing.
    """
    one = emulator.step_latent if is_bounded else emulator.step_latent_unbounded

    def advance(latent, control):
        following = one(latent, control)
        return following, following

    return jax.lax.scan(advance, latent, controls, unroll=unroll)[1]


def _quick_rollout(emulator: Emulator, state: Array, controls: Array) -> Array:
    """Return `rollout`, not unrolled: a tenth slower, but compiled in a third of the time."""
    return rollout(emulator, state, controls, unroll=1)


def _quick_rollouts(emulator: Emulator, states: Array, controls: Array) -> Array:
    """Return `_quick_rollout` from each of `states` (B, S) under `controls` (B, T, C)."""
    return jax.vmap(lambda state, held: _quick_rollout(emulator, state, held))(states, controls)
