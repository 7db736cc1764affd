"""What a model may ask for: checks of its elements before MuJoCo sees them, and of the compiled model."""

from __future__ import annotations

import re
import struct
from typing import Any

import mujoco
import numpy as np

from neuroanimator.systems.rigid.model_xml import Element, refuse, refuse_at
from neuroanimator.tables import MIN_STEP

BODY_LIMIT, FREEDOM_LIMIT, STEP_LIMIT = 500, 200, 0.1
"""Most bodies, most degrees of freedom, longest time step [s]."""

COPY_LIMIT = 10_000
"""Most copies times elements: every element may refer to the ones <replicate> copies."""

ACTUATOR_LIMIT = 500
"""Most actuators: MuJoCo simulates each muscle for seconds while it compiles."""

CELL_LIMIT, SIZE_LIMIT, MEMORY_LIMIT = 2**26, 1000, 256 * 2**20
"""Most cells (see `_cells`), largest value of SIZES, largest model and working memory [bytes]."""

SIZES = re.compile(
    "nkey|nuserdata|nuser_.*|nsample|nchannel|actdim|dim|num|sdf_initpoints|.*iterations"
)
"""Attributes whose value MuJoCo allocates or repeats, whatever it is."""

REFUSED = {
    **dict.fromkeys(("composite", "flexcomp", "flex"), "soft bodies are not supported"),
    **dict.fromkeys(("attach", "model"), "models inside models are not supported; write one model"),
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
    "working memory": ("narena", MEMORY_LIMIT),
    "model memory": ("nbuffer", MEMORY_LIMIT),
    "sensor readings": ("nsensordata", COPY_LIMIT),
    "activations": ("na", COPY_LIMIT),
}
"""By what a compiled model has much of: MuJoCo's name and the most there may be."""


def check_elements(root: Element) -> None:
    """Refuse what is not supported, and more elements than the limits, counting every copy <replicate> makes."""
    elements, copies, bodies = 0, 1, 0
    waiting = [(root, 1)]
    while waiting:
        element, times = waiting.pop()
        _check_element(element)
        if element.tag == "replicate":
            times *= max(1, _whole_number(element, "count"))
        elements, copies = elements + 1, max(copies, times)
        bodies += times if element.tag in ("body", "link") else 0
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
        refuse_at(element, "", f"{REFUSED[element.tag]}. Remove it")
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
        cells += _cells(element) + sum(
            _file_cells(assets[element.attrib[name]]) for name in element.file_attributes()
        )
        if cells > CELL_LIMIT:
            refuse_at(
                element,
                "",
                f"over {CELL_LIMIT:,} pixels or cells up to here. Use smaller images and meshes",
            )


def _cells(element: Element) -> int:
    """Return the pixels of a texture, which may be a cube of six sides, or the cells of a height field."""
    if element.tag == "texture":
        width, height = _whole_number(element, "width"), _whole_number(element, "height")
        return max(0, width) * max(height, 6 * width)
    if element.tag == "hfield":
        return max(0, _whole_number(element, "nrow")) * max(0, _whole_number(element, "ncol"))
    return 0


def _file_cells(content: bytes) -> int:
    """Return the bytes of a file, and the pixels its header tells if it is a PNG."""
    width, height = 0, 0
    if content.startswith(b"\x89PNG") and len(content) >= 24:
        width, height = struct.unpack(">II", content[16:24])
    return len(content) + width * height


def check_model(main: str, model: mujoco.MjModel) -> None:
    """Refuse a compiled model that cannot move, is too large, or has an infinite number or NaN anywhere."""
    step = model.opt.timestep
    if not MIN_STEP <= step <= STEP_LIMIT:
        refuse(main, f"option timestep={step:g}", f"wanted {MIN_STEP:g} to {STEP_LIMIT} s")
    if model.njnt == 0:
        refuse(main, "worldbody", "no joints, so nothing can move. Add a joint")
    for name, (size, limit) in LARGEST.items():
        if getattr(model, size) > limit:
            refuse(
                main, f"{name} ({size}={getattr(model, size):,})", f"at most {limit:,} is supported"
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
    is_numbers = isinstance(value, float) or (
        isinstance(value, np.ndarray) and value.dtype.kind == "f"
    )
    return not is_numbers or bool(np.isfinite(value).all())
