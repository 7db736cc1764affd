"""A system known from recordings alone: it has a layout and a rhythm, and no physics to run."""

from __future__ import annotations

from typing import Any, NoReturn

import numpy as np

from neuroanimator.appearance.skeleton import Skeleton
from neuroanimator.definitions.recorded import RecordedDefinition
from neuroanimator.errors import ArgumentError, BadFileError
from neuroanimator.systems.recorded.recording import Recording, read_recording
from neuroanimator.systems.state_parts import (
    layout_of_control,
    layout_of_state,
    numbers_of,
    structure_of_parts,
)
from neuroanimator.systems.system import Runs, Scheme, System


class RecordedSystem(System):
    """Recordings as the pipeline sees them. The file is read when its samples are needed, if the user allowed that."""

    def __init__(self, definition: RecordedDefinition, files: dict[str, Any], text: str = ""):
        self.name, self.definition = definition.name, text
        self.file: str = files["name"]
        self.sha256: str = files["sha256"]
        self.rows: tuple[int, ...] = tuple(files["rows"])
        self.origins: tuple[str, ...] = tuple(files["origins"])
        self.state = layout_of_state(definition.state)
        self.control, self.bounds = layout_of_control(definition.control)
        self.scheme = self.truth = self.fine = Scheme("recorded", definition.physics.step)
        self.structure = structure_of_parts(definition.state)
        self.skeleton = Skeleton(())
        self.rest = numbers_of(definition.state, "rest")
        self.turning = [i for row in self.structure.angles for i in np.flatnonzero(row)]

    def recording(self) -> Recording:
        """Return the recordings, angles unwrapped; BadFileError unless the user allowed their file."""
        found = read_recording(self.sha256, self.file)
        check_agreement(found, self)
        return found

    def simulate(
        self,
        starts: np.ndarray,
        controls: np.ndarray,
        dt: float,
        *,
        scheme: Scheme | None = None,
        threads: int = 1,
    ) -> Runs:
        self._refuse()

    def sample_starts(self, rng: np.random.Generator, count: int) -> np.ndarray:
        self._refuse()

    def _refuse(self) -> NoReturn:
        raise ArgumentError(
            f"recordings cannot be simulated; {self.name} is known from {self.file} alone. Use its emulator, "
            "or bring a model or a step function: neuroanimator new --help."
        )


def check_agreement(recording: Recording, system: RecordedSystem) -> None:
    """Refuse recordings that are not what the TOML file says."""
    for kind, layout, columns in (
        ("state", system.state, recording.state),
        ("control", system.control, recording.control),
    ):
        said, found = (
            [f"{p.name} {p.unit}" for p in layout.slices if p.size == 1],
            [" ".join(c) for c in columns],
        )
        if said != found or layout.size != len(found):
            raise ArgumentError(
                f"{recording.file}: {kind} columns are {', '.join(found)}; the TOML file says {', '.join(said)}."
            )
    rows = tuple(len(states) for states in recording.states)
    if rows != system.rows:
        raise BadFileError(
            f"{recording.file}: other runs than its definition says. Pass its TOML file again."
        )
    if abs(recording.step - system.physics_dt) > 1e-6 * recording.step:
        raise ArgumentError(
            f"physics.step: {recording.file} is sampled every {recording.step:g} s, came {system.physics_dt:g}."
        )
