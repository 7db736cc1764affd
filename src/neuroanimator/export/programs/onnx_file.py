"""An emulator or a policy as an ONNX file: its definition in JAX, as a graph in the user's own units."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from neuroanimator.errors import ResourceError
from neuroanimator.export.programs.definition import Model, Port, ProgramDefinition, definition_of
from neuroanimator.export.programs.exported_files import (
    CheckedProgram,
    ExportedFiles,
    write_program,
)
from neuroanimator.export.programs.onnx_graph import FLOAT, onnx_graph
from neuroanimator.export.programs.vectors import Arrays, make_vectors

if TYPE_CHECKING:
    import onnx

OPSET = 15
"""Version of ONNX' operators: the runtimes of game engines read it (Unity's reads 7 to 15)."""

IR_VERSION = 8
"""Version of the file format that goes with `OPSET`."""

BATCH = "batch"
"""Name of the first axis of every tensor."""


def write_onnx(model: Model, path: str | Path, licence: str = "") -> ExportedFiles:
    """Write `model` to `path`, after checking it against JAX, and test vectors beside it (`fish.vectors.json`).

    An emulator is (state (B, S), control (B, C)) → next_state (B, S) and, if it has a meter, trust (B, 1), which
    is `Emulator.trust`; a policy (state (B, S), phase (B, 1), command (B, 4)) → control (B, C), a state policy
    state (B, S) → control (B, C). All are in float32
    and the units of the layout. The file's metadata describe the numbers, and name the `licence` if there is one.

    Raises ResourceError without the package onnx, UnsupportedError for an operation without an operator, and
    NeuroAnimatorError if the graph differs from JAX; then nothing is written.
    """
    definition = definition_of(model, licence, has_trust=True)
    content = onnx_bytes(definition)
    vectors = make_vectors(definition, model)
    runtime, computed = run_onnx(content, vectors.inputs)
    difference = vectors.check(computed, f"The ONNX graph in {runtime}")
    program = CheckedProgram(content, {definition.name: vectors}, runtime, difference)
    return write_program(path, definition, program)


def onnx_bytes(definition: ProgramDefinition) -> bytes:
    """Return the ONNX file of `definition`, which has passed onnx' own checker."""
    onnx = _import_onnx()
    graph = onnx_graph(definition)
    nodes = []
    for node in graph.nodes:
        attributes = dict(node.attributes)
        nodes.append(onnx.helper.make_node(node.operator, node.inputs, [node.output], **attributes))
    constants = [
        onnx.numpy_helper.from_array(array, name) for name, array in graph.constants.items()
    ]
    made = onnx.helper.make_graph(
        nodes,
        definition.facts["kind"],
        [_tensor(port) for port in definition.inputs],
        [_tensor(port) for port in definition.outputs],
        constants,
    )
    opsets = [onnx.helper.make_opsetid("", OPSET)]
    model = onnx.helper.make_model(
        made, opset_imports=opsets, ir_version=IR_VERSION, producer_name="neuroanimator"
    )
    onnx.helper.set_model_props(model, definition.fact_texts())
    onnx.checker.check_model(model, full_check=True)
    return model.SerializeToString(deterministic=True)


def run_onnx(content: bytes, feeds: Arrays) -> tuple[str, Arrays]:
    """Return (name of the runtime, outputs (N, O)) for inputs (N, I) by name, in onnxruntime or onnx' own evaluator."""
    try:
        import onnxruntime
    except ImportError:
        return f"onnx {_import_onnx().__version__}", run_reference(content, feeds)
    session = onnxruntime.InferenceSession(content, providers=["CPUExecutionProvider"])
    names = [output.name for output in session.get_outputs()]
    outputs = session.run(names, feeds)
    return f"onnxruntime {onnxruntime.__version__}", _by_name(names, outputs)


def run_reference(content: bytes, feeds: Arrays) -> Arrays:
    """Return the outputs (N, O) of the file for inputs (N, I) by name, in onnx' own evaluator: slow, but always available."""
    onnx = _import_onnx()
    from onnx.reference import ReferenceEvaluator

    model = onnx.load_from_string(content)
    names = [output.name for output in model.graph.output]
    return _by_name(names, ReferenceEvaluator(model).run(names, feeds))


def _by_name(names: list[str], outputs: Iterable[Any]) -> Arrays:
    return {name: np.asarray(output) for name, output in zip(names, outputs, strict=True)}


def _tensor(port: Port) -> onnx.ValueInfoProto:
    """Return the named tensor (batch, N) of an input or output."""
    return _import_onnx().helper.make_tensor_value_info(port.name, FLOAT, [BATCH, port.layout.size])


def _import_onnx() -> Any:
    try:
        import onnx
        import onnx.checker
        import onnx.helper
        import onnx.numpy_helper
    except ImportError:
        raise ResourceError(
            "The package onnx is missing. Install it with: pip install 'neuroanimator[onnx]'"
        ) from None
    return onnx
