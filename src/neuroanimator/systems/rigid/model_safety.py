"""What a model may ask for: checks of its elements before MuJoCo sees them, and of the compiled model."""

from __future__ import annotations

import re
import struct
from typing import Any

import mujoco
import numpy as np

from neuroanimator.parsing.numbers import MIN_STEP
from neuroanimator.systems.rigid.model_xml import (
    Element,
    TooLargeError,
    named,
    refuse,
    refuse_at,
)

BODY_LIMIT = 500
"""Maximum number of a model's bodies."""

FREEDOM_LIMIT = 200
"""Maximum number of a model's degrees of freedom."""

STEP_LIMIT = 0.1
"""A model's time step may be this long [s]."""

COPY_LIMIT = 10_000
"""Maximum product of copies and elements: every element may refer to the ones <replicate> copies."""

ACTUATOR_LIMIT = 500
"""Maximum number of a model's actuators: MuJoCo simulates each muscle for seconds while it compiles."""

CELL_LIMIT = 2**26
"""Maximum number of cells of images, height fields and files together (see `_cells` and `_file_cells`)."""

SIZE_LIMIT = 1000
"""An attribute that `SIZES` matches may have this value."""

MEMORY_LIMIT = 256 * 2**20
"""Maximum size of a compiled model, and size of MuJoCo's working memory for it [bytes]."""

CUBE_SIDES = 6
"""Number of square images of a cubic texture."""

PNG_SIGNATURE = b"\x89PNG"
"""How a PNG begins."""

PNG_DIMENSIONS = slice(16, 24)
"""The bytes of a PNG's header which hold its width and its height, two big-endian 32-bit numbers (RFC 2083, 11.2.1)."""

SIZES = re.compile(
    "nkey|nuserdata|nuser_.*|nsample|nchannel|actdim|dim|num|sdf_initpoints|.*iterations"
)
"""Attributes whose value MuJoCo allocates or repeats, whatever it is."""

FLATTEN = (
    "Write one model: python -c \"import mujoco; s = mujoco.MjSpec.from_file('ROBOT.xml'); s.compile(); "
    "open('FLAT.xml', 'w').write(s.to_xml())\", then name FLAT.xml"
)
"""How a model that attaches others becomes one."""

REFUSED = {
    **dict.fromkeys(("composite", "flexcomp", "flex"), "soft bodies are not supported"),
    **dict.fromkeys(("attach", "model"), f"models inside models are not supported. {FLATTEN}"),
    "plugin": "plugins run foreign code",
    "lengthrange": "it lets a model take any time to compile",
}
"""Elements that are never allowed, and why."""

REFUSED_ATTRIBUTES = {
    (
        "mesh",
        "builtin",
    ): "it may have any number of corners. Use a mesh file or a geom's own shapes",
    ("rangefinder", "camera"): "it may have any number of pixels. Measure from a site",
}
"""Attributes, each with its element, that are never allowed, and why."""

LARGEST = {
    "bodies": ("nbody", BODY_LIMIT),
    "degrees of freedom": ("nv", FREEDOM_LIMIT),
    "model memory": ("nbuffer", MEMORY_LIMIT),
    "sensor readings": ("nsensordata", COPY_LIMIT),
    "activations": ("na", COPY_LIMIT),
}
"""By what a compiled model has much of: MuJoCo's name and the most there may be."""


TOO_MUCH = {
    "nv": "Fix joints that need not move",
    "nbody": "Join bodies that are fixed to each other",
}
"""What to do about a model that has too much of something, where it is not plain."""


def check_elements(root: Element) -> None:
    """Refuse what is not supported, and more elements than the limits, counting every copy <replicate> makes."""
    elements = 0
    copies = 1  # the most of any element so far
    bodies = 0
    waiting = [(root, 1)]
    while waiting:
        element, times = waiting.pop()
        _check_element(element)
        if element.tag == "replicate":
            times *= max(1, _whole_number(element, "count"))
        elements += 1
        copies = max(copies, times)
        if element.tag in ("body", "link"):
            bodies += times
        if bodies > BODY_LIMIT:
            refuse_at(
                element, "count", f"at least {bodies:,} bodies; at most {BODY_LIMIT} are supported"
            )
        if copies * elements > COPY_LIMIT:
            refuse_at(
                element,
                "count",
                f"more than {COPY_LIMIT:,} elements, counting copies. Write a smaller model",
            )
        waiting.extend((child, times) for child in element.children())
    actuators = copies * sum(len(section) for section in root.iter("actuator"))
    if actuators > ACTUATOR_LIMIT:
        refuse(
            root.origin[0],
            "actuator",
            f"{actuators:,} with copies; at most {ACTUATOR_LIMIT} are supported",
        )


def _check_element(element: Element) -> None:
    if element.tag in REFUSED:
        fault = REFUSED[element.tag]
        if FLATTEN not in fault:
            fault += ". Remove it"
        refuse_at(element, "", fault)
    for attribute in element.attrib:
        if (element.tag, attribute) in REFUSED_ATTRIBUTES:
            refuse_at(element, attribute, REFUSED_ATTRIBUTES[element.tag, attribute])
        if SIZES.fullmatch(attribute) and _whole_number(element, attribute) > SIZE_LIMIT:
            refuse_at(element, attribute, f"at most {SIZE_LIMIT:,} is supported")


def _whole_number(element: Element, attribute: str) -> int:
    """Return an attribute, or 0 if the element lacks it; MuJoCo accepts no more as whole numbers than Python."""
    try:
        return int(element.get(attribute, "0"))
    except ValueError:
        refuse_at(element, attribute, "wanted a whole number")


def check_cells(root: Element, assets: dict[str, bytes]) -> None:
    """Refuse images, grids and files that take too much memory together, counting a file each time it is used."""
    cells = 0
    for element in root.descendants():
        cells += _cells(element)
        for attribute in element.file_attributes():
            cells += _file_cells(assets[element.attrib[attribute]])
        if cells > CELL_LIMIT:
            file, line = element.origin
            raise TooLargeError(
                f"{file}: {named(element)}: over {CELL_LIMIT:,} pixels or cells up to here. Use smaller images and meshes "
                f"(line {line})."
            )


def _cells(element: Element) -> int:
    """Return the pixels of a texture, which may be a cube of six sides, or the cells of a height field."""
    if element.tag == "texture":
        width = _whole_number(element, "width")
        height = _whole_number(element, "height")
        return max(0, width) * max(height, CUBE_SIDES * width)
    if element.tag == "hfield":
        rows = _whole_number(element, "nrow")
        columns = _whole_number(element, "ncol")
        return max(0, rows) * max(0, columns)
    return 0


def _file_cells(content: bytes) -> int:
    """Return the bytes of a file, and the pixels its header tells if it is a PNG."""
    is_png = content.startswith(PNG_SIGNATURE) and len(content) >= PNG_DIMENSIONS.stop
    if not is_png:
        return len(content)
    width, height = struct.unpack(">II", content[PNG_DIMENSIONS])
    return len(content) + width * height


def check_model(main: str, model: mujoco.MjModel) -> None:
    """Refuse a compiled model that cannot move, is too large, or has an infinite number or NaN anywhere."""
    step = model.opt.timestep
    if not MIN_STEP <= step <= STEP_LIMIT:
        refuse(main, f"option timestep={step:g}", f"wanted {MIN_STEP:g} to {STEP_LIMIT} s")
    if model.njnt == 0:
        refuse(main, "worldbody", "no joints, so nothing can move. Add a joint")
    if model.nhistory:
        refuse(
            main,
            "delay",
            "what an actuator or a sensor remembers of the past is no part of the state. Remove nsample and delay",
        )
    for name, (field, limit) in LARGEST.items():
        size = getattr(model, field)
        if size > limit:
            refuse(
                main,
                f"{name} ({field}={size:,})",
                f"at most {limit:,} is supported. {TOO_MUCH.get(field, 'Write a smaller model')}",
            )
    for part in (model, model.opt, model.stat):
        for name in dir(part):
            if not _is_finite(getattr(part, name)):
                refuse(
                    main,
                    name,
                    "not finite. Write finite numbers, and leave out a range that has no end",
                )


def _is_finite(value: Any) -> bool:
    """Return False for a number or an array with an infinite number or NaN; True for anything else."""
    is_array = isinstance(value, np.ndarray) and value.dtype.kind == "f"
    if not is_array and not isinstance(value, float):
        return True
    return bool(np.isfinite(value).all())
