"""A system whose model is missing: its emulator gives its states and goals, but not its physics."""

from __future__ import annotations

import numpy as np

from neuroanimator.definitions.carried import read_definition_text
from neuroanimator.emulator.spec import EmulatorSpec
from neuroanimator.errors import BadFileError
from neuroanimator.physics.schemes import schemes_of
from neuroanimator.state.structure import Structure
from neuroanimator.systems.system import SystemWithoutPhysics


class AbsentModel(SystemWithoutPhysics):
    """The system of an emulator, without physics; goals at a site of the model are left out."""

    has_ground = True

    def __init__(self, spec: EmulatorSpec, structure: Structure, missing: str):
        """Make the system of an emulator's `spec` and the `structure` of its states; `missing` says what is missing."""
        definition = read_definition_text(spec.definition).definition
        self.name = spec.system
        self.definition_text = spec.definition
        self.missing = missing
        self.is_tied = spec.is_tied
        self.state = spec.state
        self.control = spec.control
        self.bounds = spec.bounds
        self.structure = structure
        self.skeleton = spec.skeleton
        self.scheme, self.truth, self.fine = schemes_of(definition.physics)
        self.rest = np.array(spec.rest)
        tables = definition.goals.items()
        self.goals = self.goals_of({name: table for name, table in tables if not table.site})

    @property
    def reason(self) -> BadFileError:
        return BadFileError(self.missing)
