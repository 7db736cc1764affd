"""A creature's motion: super step by super step through the emulator, then keyframes of its bones."""

import math

import bpy
import numpy as np
from mathutils import Matrix, Quaternion, Vector

from . import poses
from .creature import model_of, parts_of, policy_path, rest_matrix

MAX_CONTROLS = 32
"""Controls that can be set by hand."""

MAX_LEAD = 1.2
"""How far the asked heading may lead the body's [rad]: what it cannot follow is not saved up for later."""


class LostError(Exception):
    """The emulator left the numbers behind."""


def simulate(context, root, on_step=lambda share: None):
    """Return (model, states (T+1, S)) of the creature at `root`, as its settings say at the times they are asked.

    Settings may be animated, and so may the target: both are looked at when each super step begins.
    Raises ValueError for a start there is not, and LostError where numbers are not finite.
    """
    settings = root.neuroanimator
    model = model_of(settings.path)
    dt = model.facts["dt"]
    scene = context.scene
    rate = scene.render.fps / scene.render.fps_base
    steps = max(1, math.ceil(settings.seconds / dt - 1e-9))
    drive = DRIVES[settings.drive](model, root)
    state = start_state(model, settings.start)
    states = [state]
    shown = scene.frame_current
    try:
        for step in range(steps):
            scene.frame_set(settings.first_frame + int(step * dt * rate))
            state = model.step(state, drive.control(step, state))
            if not np.isfinite(state).all():
                raise LostError(
                    f"After {step * dt:g} s the motion diverged: the commands are far from what was trained. Command less."
                )
            states.append(state)
            on_step((step + 1) / steps)
    finally:
        scene.frame_set(shown)
    return model, np.stack(states)


def start_state(model, text):
    """Return the state at rest with parts as `text` says, such as `root.position=0,0,8; hip=0.3`."""
    state = model.rest
    where, entry = {}, 0
    for name, size, _ in model.facts["state"]:
        where[name] = slice(entry, entry + size)
        entry += size
    for part in filter(None, map(str.strip, text.split(";"))):
        name, _, values = part.partition("=")
        if name.strip() not in where:
            raise ValueError(f"Start: no part called '{name.strip()}'. Parts: {', '.join(where)}.")
        try:
            numbers = [float(value) for value in values.split(",")]
        except ValueError:
            numbers = []
        span = where[name.strip()]
        if len(numbers) != span.stop - span.start or not np.isfinite(numbers).all():
            wanted = span.stop - span.start
            raise ValueError(
                f"Start: wanted {wanted} finite numbers for '{name.strip()}', got '{values}'."
            )
        state[span] = numbers
    return state


class Held:
    """Controls as they are set by hand: -1 to 1, 0 in the middle."""

    def __init__(self, model, root):
        self._low, self._high = (np.array(model.facts[f"control_{end}"]) for end in ("low", "high"))
        self._root = root

    def control(self, step, state):
        asked = np.array(self._root.neuroanimator.controls[: len(self._low)])
        share = np.zeros(len(self._low))
        share[: len(asked)] = asked
        return (self._low + self._high) / 2 + share * (self._high - self._low) / 2


class Gait:
    """The pattern a creature swims by: middle + half width * amplitude * sin(2 pi t / period - lag)."""

    def __init__(self, model, root):
        if "gait" not in model.body:
            raise ValueError(f"{model.facts['system']} has no gait. Set its controls instead.")
        self._period, amplitudes, lags = model.body["gait"]
        self._amplitudes, self._lags = np.array(amplitudes), np.array(lags)
        self._low, self._high = (np.array(model.facts[f"control_{end}"]) for end in ("low", "high"))
        self._dt = model.facts["dt"]
        self._root = root

    def control(self, step, state):
        strength = self._root.neuroanimator.strength
        angle = 2 * math.pi / self._period * (step + 0.5) * self._dt
        wave = strength * self._amplitudes * np.sin(angle - self._lags)
        control = (self._low + self._high) / 2 + wave * (self._high - self._low) / 2
        return np.clip(control, self._low, self._high)


class Steered:
    """A policy that is told how fast to go and where to: by commands, or toward an object."""

    def __init__(self, model, root):
        path = policy_path(root.neuroanimator.path)
        if path is None:
            raise ValueError(
                f"{model.facts['system']} has no policy to be steered by. Use its gait or its controls."
            )
        self._policy = model_of(path)
        self._model = model
        self._root = root
        self._phase = 0.0
        self._heading = None

    def control(self, step, state):
        root = self._root
        settings = root.neuroanimator
        position, forward, up, roll = poses.pose_of(self._model.body["root"], state)
        if settings.target is not None:
            place = root.matrix_world.inverted() @ settings.target.matrix_world.translation
            to = np.array(place) - position
            direction = poses.unit(to)
        else:
            direction = self._asked_direction(settings, math.atan2(forward[1], forward[0]))
        left = poses.unit(np.cross(up, forward))
        ahead, aside = direction @ forward, direction @ left
        above = direction @ np.cross(forward, left)
        climb = math.atan2(above, math.hypot(ahead, aside))
        command = [settings.speed, math.atan2(aside, ahead), climb, -roll]
        low, high = (np.array(self._policy.facts[f"command_{end}"]) for end in ("low", "high"))
        control = self._policy.control(state, self._phase, np.clip(command, low, high))
        self._phase = (self._phase + self._policy.facts["phase_per_step"]) % (2 * math.pi)
        return control

    def _asked_direction(self, settings, heading):
        """Return where to go by the commands, from the heading that was asked for before, if that is not far ahead."""
        asked = heading if self._heading is None else self._heading
        asked += settings.turn * self._model.facts["dt"]
        lead = (asked - heading + math.pi) % (2 * math.pi) - math.pi
        self._heading = heading + max(-MAX_LEAD, min(MAX_LEAD, lead))
        level = math.cos(settings.climb)
        return np.array(
            [
                level * math.cos(self._heading),
                level * math.sin(self._heading),
                math.sin(settings.climb),
            ]
        )


DRIVES = {"GAIT": Gait, "STEERED": Steered, "CONTROLS": Held}
"""What moves a creature, by what the settings call it."""


def bake(context, root, on_step=lambda share: None):
    """Give the creature at `root` keyframes of its motion; return how many frames. Raises as `simulate`.

    The scene lasts at least as long.
    """
    model, states = simulate(context, root, on_step)
    settings = root.neuroanimator
    rate = context.scene.render.fps / context.scene.render.fps_base
    seconds = (len(states) - 1) * model.facts["dt"]
    times = np.arange(int(seconds * rate + 1e-6) + 1) / rate
    body = model.body
    frames = poses.between(states, model.facts["dt"], times, body["rates"], body["orientations"])
    local = poses.local_poses(body["bones"], frames)
    parts = parts_of(root)
    for part in parts.values():
        part.animation_data_clear()
    if -1 in parts:
        _key_rig(parts[-1], body["bones"], local, settings.first_frame)
    else:
        for number, part in parts.items():
            if body["bones"][number]["joints"] or body["bones"][number].get("binding"):
                turns = poses.continuous(local[number][1])
                _key(part, local[number][0], turns, settings.first_frame)
    scene = context.scene
    scene.frame_end = max(scene.frame_end, settings.first_frame + len(times) - 1)
    return len(times)


def _key_rig(rig, bones, local, first_frame):
    for bone, (positions, orientations) in zip(bones, local, strict=True):
        posed = rig.pose.bones[bone["name"]]
        made = posed.bone.matrix_local
        # From the bone's own frame at rest to the armature's, where the emulator's bones are.
        into = rest_matrix(bone).inverted() @ made
        back = made.inverted()
        places, turns = [], []
        for position, orientation in zip(positions, orientations, strict=True):
            moved = Matrix.LocRotScale(Vector(position), Quaternion(orientation), None)
            place, turn, _ = (back @ moved @ into).decompose()
            places.append(place)
            turns.append(turn)
        _key(posed, np.array(places), poses.continuous(np.array(turns)), first_frame)


def _key(part, positions, orientations, first_frame):
    """Set keyframes of an object or a bone, one a frame."""
    for number, (position, orientation) in enumerate(zip(positions, orientations, strict=True)):
        part.location = position
        part.rotation_quaternion = orientation
        part.keyframe_insert("location", frame=first_frame + number)
        part.keyframe_insert("rotation_quaternion", frame=first_frame + number)


def draw_settings(layout, root):
    """Draw what can be set of the creature at `root`."""
    settings = root.neuroanimator
    for name in ("path", "first_frame", "seconds", "start", "drive"):
        layout.prop(settings, name)
    if settings.drive == "GAIT":
        layout.prop(settings, "strength")
    elif settings.drive == "STEERED":
        layout.prop(settings, "target")
        for name in ("speed", "turn", "climb"):
            layout.prop(settings, name)
    else:
        names = [name for name, size, _ in _controls(settings.path) for _ in range(size)]
        for number, name in enumerate(names[:MAX_CONTROLS]):
            layout.prop(settings, "controls", index=number, text=name, slider=True)


def _controls(path):
    try:
        return model_of(bpy.path.abspath(path)).facts["control"]
    except (OSError, ValueError):
        return []
