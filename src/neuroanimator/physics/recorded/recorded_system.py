"""A system known from recordings alone: it has a layout and a sampling interval, but no physics."""

from __future__ import annotations

from typing import Any

from neuroanimator.appearance.skeleton import Skeleton
from neuroanimator.definitions.recorded import RecordedDefinition
from neuroanimator.errors import ArgumentError
from neuroanimator.physics.state_parts import (
    layout_of_control,
    layout_of_state,
    numbers_of,
    structure_of_parts,
    wrapping_entries,
)
from neuroanimator.systems.recording_file import RecordingFile
from neuroanimator.systems.system import Scheme, SystemWithoutPhysics


class RecordedSystem(SystemWithoutPhysics):
    """Recordings as a system. Their file is read when its samples are needed, if the user has allowed it."""

    is_self_contained = False
    has_ground = True

    def __init__(
        self, definition: RecordedDefinition, files: dict[str, Any], definition_text: str = ""
    ):
        """`files` holds the name, the sha256 and the runs of the recordings; `definition_text` is the text of both."""
        self.name = definition.name
        self.definition_text = definition_text
        self.state = layout_of_state(definition.state)
        self.control, self.bounds = layout_of_control(definition.control)
        self.structure = structure_of_parts(definition.state)
        self.skeleton = Skeleton(())
        self.rest = numbers_of(definition.state, "rest")
        sampled = Scheme("recorded", definition.physics.step)
        self.scheme = sampled
        self.truth = sampled
        self.fine = sampled
        self._recordings = RecordingFile(
            name=files["name"],
            sha256=files["sha256"],
            rows=tuple(files["rows"]),
            origins=tuple(files["origins"]),
            state=self.state,
            control=self.control,
            step=sampled.dt,
            is_resampled=definition.resample,
            has_estimates=definition.velocities,
            angles=tuple(wrapping_entries(definition.state)),
        )
        self.recordings = self._recordings
        self.goals = self.goals_of(definition.goals)

    @property
    def reason(self) -> ArgumentError:
        return ArgumentError(
            f"recordings cannot be simulated; {self.name} is known from {self._recordings.name} alone. "
            "Use its emulator, or bring a model or a step function: neuroanimator new --help."
        )
