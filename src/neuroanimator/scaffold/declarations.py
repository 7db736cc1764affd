"""Checked declarations of a step file: STEP, STATE, CONTROL and the rest."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType
from typing import Annotated, Any

from pydantic import BeforeValidator, Field, StrictBool, StrictInt, ValidationError

from neuroanimator.definitions.function import MAX_STEP, FunctionStep
from neuroanimator.errors import BadFileError
from neuroanimator.files.names import PartName
from neuroanimator.files.tables import MIN_STEP, Finite, Table
from neuroanimator.scaffold.defaults import ANGLE_SPREAD
from neuroanimator.text import listed

MAX_SHOWN = 60
"""Maximum number of characters of a wrong declaration shown in an error."""

WANTED = {
    "STEP": f"a line like `STEP = 0.01`, from {MIN_STEP:g} to {MAX_STEP:g} s",
    "STATE": 'a line like `STATE = {"angle": "rad", "speed": "rad/s"}`',
    "CONTROL": 'a line like `CONTROL = {"torque": ("N·m", -2.0, 2.0)}`',
    "ANGLES": 'a line like `ANGLES = ["angle"]`',
    "RATES": 'a line like `RATES = {"angle": "speed"}`',
    "REST": 'a line like `REST = {"angle": 0.0}`',
    "SPREAD": 'a line like `SPREAD = {"angle": 3.14, "speed": 4.0}`',
    "BATCHED": "a line like `BATCHED = True`",
    "ODE": "a line like `ODE = True`",
    "PARAMETERS": 'a line like `PARAMETERS = {"length": ("m", 0.5, 2.0)}`',
}
"""Example of each declaration, shown in the error about it."""

WANTED_NAME = "a name of letters, digits and _ . -, at most 40, beginning with a letter"
"""Form of the names of parts, shown in the error about one."""


def _as_numbers(value: Any) -> Any:
    """Return NumPy's numbers and arrays, or a single number, as a list of Python's."""
    plain = value.tolist() if hasattr(value, "tolist") else value
    return plain if isinstance(plain, list | tuple) else [plain]


Numbers = Annotated[list[Finite], BeforeValidator(_as_numbers)]
"""One number, or several."""


class Declarations(Table):
    """Everything a step file declares, by the names used there."""

    STEP: FunctionStep
    STATE: dict[PartName, str | tuple[str, StrictInt]] = Field(min_length=1)
    """Unit of each part, or its unit and size."""
    CONTROL: dict[PartName, tuple[str, Numbers, Numbers]] = Field(min_length=1)
    """Unit, smallest and largest value of each control."""
    ANGLES: tuple[str, ...] = ()
    RATES: dict[str, str] = Field(default={})
    REST: dict[str, Numbers] = Field(default={})
    SPREAD: dict[str, Numbers] = Field(default={})
    BATCHED: StrictBool | None = None
    ODE: StrictBool = False
    PARAMETERS: dict[PartName, tuple[str, Finite, Finite]] = Field(default={})
    """Unit, smallest and largest value of each further argument of `step`."""

    def parts(self) -> list[dict[str, Any]]:
        """Return the tables of the parts of the state, as in a definition."""
        parts = []
        for name, declared in self.STATE.items():
            unit, size = (declared, 1) if isinstance(declared, str) else declared
            is_angle = name in self.ANGLES
            spread = [ANGLE_SPREAD if is_angle else 0.0]
            part = {
                "name": name,
                "unit": unit,
                "size": size,
                "feature": "sine" if is_angle else "plain",
                "rate": self.RATES.get(name, ""),
                "rest": _repeated(self.REST.get(name, [0.0]), size),
                "spread": _repeated(self.SPREAD.get(name, spread), size),
            }
            parts.append(part)
        return parts

    def parameters(self) -> dict[str, dict[str, Any]]:
        """Return the tables of the parameters, as in a definition."""
        return {
            name: {"sets": name, "range": [low, high], "unit": unit}
            for name, (unit, low, high) in self.PARAMETERS.items()
        }


def _repeated(numbers: list[float], size: int) -> list[float]:
    return numbers * size if len(numbers) == 1 else numbers


def read_declarations(path: Path, module: ModuleType) -> Declarations:
    """Return the declarations in the module of the step file at `path`; BadFileError shows the right form of a wrong one."""
    names = [name for name in Declarations.model_fields if hasattr(module, name)]
    try:
        declared = Declarations.model_validate({name: getattr(module, name) for name in names})
    except ValidationError as error:
        raise BadFileError(f"{path.name}: {_fault(error, module)}.") from error
    for name in ("ANGLES", "RATES", "REST", "SPREAD"):
        for part in getattr(declared, name):
            if part not in declared.STATE:
                raise BadFileError(
                    f"{path.name}: {name}: no part '{part}' in STATE. Parts: {listed(declared.STATE)}."
                )
    return declared


def _fault(error: ValidationError, module: ModuleType) -> str:
    """Return a message on the first wrong declaration: what was wanted and what was given."""
    fault = error.errors()[0]
    name, *path = fault["loc"]
    if "[key]" in path:
        return f"{name}: wanted {WANTED_NAME}, got {repr(fault['input'])[:MAX_SHOWN]}"
    given = "nothing"
    if hasattr(module, str(name)):
        given = repr(fault["input"])[:MAX_SHOWN]
    return f"{name}: wanted {WANTED[str(name)]}, got {given}"
