"""What a page may ask, checked: every number finite, every text short, and nothing else."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field, TypeAdapter, ValidationError

from neuroanimator import ArgumentError
from neuroanimator.authoring import Finite, Table, first_fault, parse_json_object, quoted
from neuroanimator_studio.job_plan import Size

MAX_STATE = 4096
"""Numbers a state or a control may have: as many as a layout read from a file."""

MAX_ROWS = 20_000
"""Rows of controls or states."""

MAX_TEXTS = 1_000
"""Names and texts in a request: what takes most time and memory to read, and a request of numbers has few."""

MAX_TEXT = 1 << 20
"""Characters of states in base64."""

MAX_MOTION = 7 << 20
"""Characters of the states of a whole motion in base64."""


Name = Annotated[str, Field(min_length=1, max_length=200)]
Number = Annotated[int, Field(ge=0, le=2**53)]
"""What a page counts its requests by: JavaScript's whole numbers."""

Vector = Annotated[list[Finite], Field(min_length=1, max_length=MAX_STATE, fail_fast=True)]
Rows = Annotated[list[Vector], Field(min_length=1, max_length=MAX_ROWS, fail_fast=True)]
Point = tuple[Finite, Finite, Finite]
Pushes = Annotated[list[tuple[Number, Vector]], Field(max_length=MAX_ROWS, fail_fast=True)]
"""What somebody's mouse did to the state: before super step [0], so much was added to it [1]."""


class Replay(Table):
    """What do these controls do on the true physics?"""

    id: Number
    do: Literal["replay"]
    bundle: Name
    start: Vector
    controls: Rows
    pushes: Pushes = Field(default_factory=list)


class Judge(Table):
    """How near does this motion come to a goal?"""

    id: Number
    do: Literal["judge"]
    bundle: Name
    goal: Name
    target: Point | None = None
    states: Annotated[str, Field(max_length=MAX_TEXT)] | Rows
    """Rows of numbers, or base64 of little-endian float32; the last state counts."""


class JudgeDescent(Table):
    """Has this motion of the physics done what the descent was for?"""

    id: Number
    do: Literal["judge_descent"]
    bundle: Name
    values: dict[Name, Vector] = Field(default_factory=dict)
    """Where what may be moved was moved to."""
    states: Annotated[str, Field(max_length=MAX_TEXT)] | Rows
    """As in `Judge`, but all of them count."""


class Train(Table):
    """Train an emulator of a system of the package, or of a model dropped before."""

    id: Number
    do: Literal["train"]
    system: Name | None = None
    model: Name | None = None
    substeps: Annotated[int, Field(ge=1, le=1000)] = 50
    size: Size = "usual"
    count: int | None = None
    updates: int | None = None


class Jobs(Table):
    """How far are the trainings?"""

    id: Number
    do: Literal["jobs"]


class OfJob(Table):
    """Stop a training, go on with it, or remove it."""

    id: Number
    do: Literal["stop", "resume", "forget"]
    job: Name


Asked = Replay | Judge | JudgeDescent | Train | Jobs | OfJob
"""All that a page may ask on its socket."""

REQUEST: TypeAdapter[Asked] = TypeAdapter(Annotated[Asked, Field(discriminator="do")])


class Export(Table):
    """Write this motion for another program."""

    bundle: Name
    format: Literal["glb", "csv", "usda", "usdz", "html"]
    rate: Annotated[float, Field(gt=0, le=1000)] | None = None
    start: Vector
    controls: Rows
    pushes: Pushes = Field(default_factory=list)
    states: Annotated[str, Field(max_length=MAX_MOTION)] | None = None
    """The motion as the page has it, a row a super step, in base64 of little-endian float32: what hangs on rounding, such as a
    walk, is not made again from its controls."""
    source: Literal["emulator", "physics"] = "emulator"
    """What makes the motion that is shown."""
    ghost: bool = False
    """Whether the physics goes along as a ghost."""


DOES = ("replay", "judge", "judge_descent", "train", "jobs", "stop", "resume", "forget")
"""What a page may ask for."""

EXPORT = TypeAdapter(Export)


def read_request(text: str, largest: int) -> Asked:
    """Return what a page asks; ValueError for what is no JSON, ArgumentError for JSON that asks nothing known."""
    values = parse_json_object(text, largest, MAX_TEXTS)
    if str(values.get("do")) not in DOES:
        raise ArgumentError(
            f"do: no request called {quoted(values.get('do'))}. Requests: {', '.join(DOES)}."
        )
    return _checked(REQUEST, values)


def read_export(content: bytes, largest: int) -> Export:
    """Return what a page wants exported; errors are those of `read_request`."""
    return _checked(EXPORT, parse_json_object(content, largest, MAX_TEXTS))


def request_id(text: str, largest: int) -> int | None:
    """Return the number of a request that asks nothing known; None if it has none."""
    number = parse_json_object(text, largest, MAX_TEXTS).get("id")
    return number if isinstance(number, int) and not isinstance(number, bool) else None


def _checked(adapter: Any, values: dict[str, Any]) -> Any:
    try:
        return adapter.validate_python(values)
    except ValidationError as error:
        raise ArgumentError(f"{first_fault(error)}.") from error
