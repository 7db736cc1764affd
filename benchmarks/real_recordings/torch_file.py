"""Tensors of the older serialisation of PyTorch (`torch.save` before 1.6), read without PyTorch and without unpickling.

Such a file is five pickles (a magic number, the protocol, sizes of types, the object, the keys of storages) and then,
for each storage, the number of its elements and their bytes. The pickles are only looked through, by opcode: nothing
in them is ever called.
"""

from __future__ import annotations

import io
import pickletools
from typing import Any

import numpy as np
from jaxtyping import Float

MAGIC = 0x1950A86A20F9469CFC6C
"""The number the first pickle holds."""

STORAGES = {"torch DoubleStorage": "<f8", "torch FloatStorage": "<f4"}
"""Types of elements by the name of their storage."""

PICKLES = 5
OBJECT = 3
"""The position of the object's pickle among the five."""

COUNT_BYTES = 8
"""The number of elements of a storage takes so many bytes."""


def read_tensor(content: bytes) -> Float[np.ndarray, ...]:
    """Return the one tensor in a file; ValueError says what is not as expected."""
    stream = io.BytesIO(content)
    pickles = [_opcodes(stream) for _ in range(PICKLES)]
    if ("LONG1", MAGIC) not in pickles[0]:
        raise ValueError("not a tensor of the older serialisation of PyTorch")
    opcodes = pickles[OBJECT]
    element = _element(opcodes)
    offset, shape, strides = _placement(opcodes)
    count = int.from_bytes(stream.read(COUNT_BYTES), "little")
    size = count * np.dtype(element).itemsize
    data = stream.read()
    if len(data) != size:
        raise ValueError(f"{len(data)} bytes of numbers, wanted {size}")
    storage = np.frombuffer(data, element)
    if offset or strides != _row_major(shape) or int(np.prod(shape)) != count:
        raise ValueError(f"a tensor of shape {shape} and strides {strides}: wanted one whole array")
    return storage.reshape(shape).astype(float)


def _opcodes(stream: io.BytesIO) -> list[tuple[str, Any]]:
    """Return the (name, argument) of each opcode of the next pickle, those of its memory left out."""
    codes = []
    for opcode, argument, _ in pickletools.genops(stream):
        if "PUT" not in opcode.name and opcode.name != "MEMOIZE":
            codes.append((opcode.name, argument))
    return codes


def _element(opcodes: list[tuple[str, Any]]) -> str:
    names = [argument for name, argument in opcodes if name == "GLOBAL"]
    known = [STORAGES[name] for name in names if name in STORAGES]
    if len(known) != 1 or "torch._utils _rebuild_tensor_v2" not in names:
        raise ValueError(f"holds {', '.join(names)}; wanted one tensor of {', '.join(STORAGES)}")
    return known[0]


def _placement(opcodes: list[tuple[str, Any]]) -> tuple[int, tuple[int, ...], tuple[int, ...]]:
    """Return where a tensor begins in its storage, its shape and its strides: the integers behind the storage's name."""
    names = [name for name, _ in opcodes]
    begin = names.index("BINPERSID") + 1
    end = names.index("NEWFALSE", begin)
    stack: list[Any] = []
    for name, argument in opcodes[begin:end]:
        if name.startswith("BININT"):
            stack.append(argument)
        elif name == "MARK":
            stack.append(None)
        elif name.startswith("TUPLE"):
            first = _tuple_begin(name, stack)
            members = tuple(member for member in stack[first:] if member is not None)
            stack[first:] = [members]
        else:
            raise ValueError(f"{name} where a tensor's shape should be")
    if [type(entry) for entry in stack] != [int, tuple, tuple]:
        raise ValueError("a tensor without an offset, a shape and strides")
    return stack[0], stack[1], stack[2]


def _tuple_begin(name: str, stack: list[Any]) -> int:
    """Return where on the stack the members of a tuple begin: TUPLE1 to TUPLE3 say how many, TUPLE goes back to a mark."""
    if name == "TUPLE":
        return len(stack) - 1 - stack[::-1].index(None)
    return len(stack) - int(name.removeprefix("TUPLE"))


def _row_major(shape: tuple[int, ...]) -> tuple[int, ...]:
    strides = []
    for axis in range(len(shape)):
        strides.append(int(np.prod(shape[axis + 1 :])))
    return tuple(strides)
