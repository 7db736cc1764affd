"""Pictures of a motion as it happens: a drawing process that stays, and takes one state after another.

It is a process of its own for the reason `video` gives; unlike a film it knows nothing of what comes next.
"""

from __future__ import annotations

import io
import os
import subprocess
from contextlib import suppress
from typing import IO, final

import numpy as np
from jaxtyping import Float, UInt8

from neuroanimator.emulator.spec import EmulatorSpec
from neuroanimator.errors import ArgumentError, ResourceError
from neuroanimator.executor.python_command import python_command
from neuroanimator.export.film.clip_bytes import pack_files
from neuroanimator.export.film.video import graphics_backend, why_no_graphics
from neuroanimator.storage.files import canonical_json

HEADER_SIZE = 8
"""Bytes of the number that says how long the header is."""

WORKER = "neuroanimator.export.film.live_worker"
"""The module that the drawing process runs."""

PATIENCE = 10.0
"""Time a drawing process is given to end by itself [s]."""


@final
class LiveView:
    """A window nobody sees: states in, pictures out. `close` it when done."""

    def __init__(self, spec: EmulatorSpec, *, width: int = 480, height: int = 360):
        """Start the drawing process for the system `spec` tells of; ResourceError says what it lacks."""
        backend = graphics_backend()
        if backend is None:
            raise ResourceError(why_no_graphics())
        self._shape = (height, width, 3)
        self._process = subprocess.Popen(
            python_command("-m", WORKER),
            env={**os.environ, "MUJOCO_GL": backend},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
        )
        self._send(_header(spec, width, height))

    def draw(self, state: Float[np.ndarray, " S"]) -> UInt8[np.ndarray, "H W 3"]:
        """Return the picture of `state`; ResourceError if it cannot be drawn."""
        self._send(np.ascontiguousarray(state, "<f8").tobytes())
        size = int(np.prod(self._shape))
        raw = self._pipe(self._process.stdout).read(size)
        if len(raw) < size:
            self.close()
            raise ResourceError(
                "The drawing process ended. 'neuroanimator doctor' says whether drawing works here."
            )
        return np.frombuffer(raw, np.uint8).reshape(self._shape).copy()

    def close(self) -> None:
        """End the drawing process."""
        for pipe in (self._process.stdin, self._process.stdout):
            if pipe is not None:
                with suppress(BrokenPipeError):  # it may have ended already
                    pipe.close()
        try:
            self._process.wait(PATIENCE)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def _send(self, content: bytes) -> None:
        pipe = self._pipe(self._process.stdin)
        try:
            pipe.write(content)
            pipe.flush()
        except (BrokenPipeError, ValueError):
            pass  # reading says that it has ended

    @staticmethod
    def _pipe(pipe: IO[bytes] | None) -> IO[bytes]:
        assert pipe is not None
        return pipe


@final
class LiveCamera:
    """Takes pictures of an emulator's states; the drawing process starts with the first one."""

    def __init__(self, spec: EmulatorSpec):
        self._spec = spec
        self._view: LiveView | None = None

    def picture(self, state: Float[np.ndarray, " S"]) -> UInt8[np.ndarray, "H W 3"]:
        """Return the picture of `state`; ResourceError if it cannot be drawn."""
        if self._view is None:
            self._view = LiveView(self._spec)
        return self._view.draw(state)

    def close(self) -> None:
        """End the drawing process, if there is one."""
        if self._view is not None:
            self._view.close()
        self._view = None


def checked_render_mode(mode: str | None) -> str | None:
    """Return `mode` if pictures can be had that way; ArgumentError otherwise."""
    if mode not in (None, "rgb_array"):
        raise ArgumentError(f"No render mode called '{mode}'. Modes: rgb_array.")
    return mode


def _header(spec: EmulatorSpec, width: int, height: int) -> bytes:
    """Return what the drawing process must know, its length first."""
    content = io.BytesIO()
    np.savez(
        content,
        system=np.array(spec.system),
        definition=np.array(spec.definition),
        files=pack_files([spec.definition]),
        rest=np.array(spec.rest),
        skeleton=np.array(canonical_json(spec.skeleton.to_json())),
        size=np.array([width, height, spec.state.size]),
    )
    raw = content.getvalue()
    return len(raw).to_bytes(HEADER_SIZE, "little") + raw
