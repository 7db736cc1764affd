"""Write an emulator or a policy as an .npz file for Blender: python blender/npz_file.py my_robot.emulator.safetensors

    definition in JAX → program → graph of operators (as for ONNX) → arrays and JSON in one .npz, no pickle

With it goes what draws the body: its bones, its skin, and how states are joined between super steps.
"""

from __future__ import annotations

import io
import json
import sys
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

sys.path.insert(0, str(Path(__file__).parent / "extension"))  # the runtime goes into the extension

import numpy_runtime

from neuroanimator.appearance.colour import linear_of
from neuroanimator.appearance.shape_mesh import shape_mesh
from neuroanimator.appearance.skeleton import Skeleton
from neuroanimator.appearance.skin_mesh import colours_of, parts_of, skin_mesh
from neuroanimator.control.policies.policy import Policy, load_policy
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.errors import NeuroAnimatorError
from neuroanimator.export.programs.definition import ProgramDefinition, definition_of
from neuroanimator.export.programs.formats import POLICY_ENDING
from neuroanimator.export.programs.onnx_graph import onnx_graph
from neuroanimator.export.programs.vectors import make_vectors
from neuroanimator.files.atomic import write_whole
from neuroanimator.state.pose_entries import describe_root


class Body(NamedTuple):
    """What draws a body: its bones, its skin, and what states are joined by between super steps."""

    described: dict[str, Any]
    """As JSON."""
    arrays: dict[str, np.ndarray]
    """Of the skin at rest, in single precision."""


NO_BODY = Body({}, {})
"""What draws a policy: nothing."""


def write_npz(model: Emulator | Policy, path: Path, licence: str = "") -> str:
    """Write `model` to `path`, after holding it against JAX; return a line that says so.

    Raises UnsupportedError for an operation there is no operator for, and NeuroAnimatorError where the program does
    not do what JAX does; then nothing is written.
    """
    definition = definition_of(model, licence, has_trust=True)
    content = npz_bytes(definition, _body(model))
    vectors = make_vectors(definition, model)
    inputs = [vectors.inputs[port.name] for port in definition.inputs]
    computed = numpy_runtime.load(io.BytesIO(content)).run_all(*inputs)
    difference = vectors.check(computed, "The program in NumPy")
    write_whole(path, content)
    return f"{path}: {len(content) / 1e3:.0f} kB, what JAX does to {difference:.0e} of the output's scale. {definition.missing}"


def npz_bytes(definition: ProgramDefinition, body: Body = NO_BODY) -> bytes:
    """Return the .npz file of `definition` and of what draws its `body`, the same bytes each time."""
    graph = onnx_graph(definition)
    told = {
        "format": numpy_runtime.FORMAT,
        "facts": definition.facts,
        "inputs": [port.name for port in definition.inputs],
        "output": definition.output_names[0],
        "more_outputs": definition.output_names[1:],
        "constants": list(graph.constants),
        "nodes": [
            [node.operator, node.inputs, node.output, node.attributes] for node in graph.nodes
        ],
        "body": body.described,
    }
    text = json.dumps(told, separators=(",", ":"), allow_nan=False).encode("ascii")
    arrays = {"program": np.frombuffer(text, np.uint8), **graph.constants, **body.arrays}
    file = io.BytesIO()
    np.savez_compressed(file, allow_pickle=False, **arrays)
    return file.getvalue()


def _body(model: Emulator | Policy) -> Body:
    if isinstance(model, Policy):
        return NO_BODY
    spec = model.spec
    bones, arrays = _bones(spec.skeleton)
    described: dict[str, Any] = {
        "bones": bones,
        "rates": spec.rates,
        "orientations": model.state_structure.orientations,
        "root": describe_root(model.state_structure),
    }
    if model.gait is not None:
        described["gait"] = model.gait.to_json()
    skin = spec.skeleton.skin
    if skin is not None and skin.kind != "mesh":
        mesh = skin_mesh(spec.skeleton)
        arrays["skin_points"] = mesh.points.astype(np.float32)
        arrays["skin_triangles"] = mesh.triangles.astype(np.uint32)
        arrays["skin_bones"] = mesh.bones.astype(np.uint16)
        arrays["skin_weights"] = mesh.weights.astype(np.float32)
        arrays["skin_light"] = linear_of(colours_of(skin, mesh.shades)).astype(np.float32)
    return Body(described, arrays)


def _bones(skeleton: Skeleton) -> tuple[list[dict[str, Any]], dict[str, np.ndarray]]:
    """Return the bones as JSON, the triangles of their shapes as arrays that they name."""
    rows = skeleton.bones_to_json()
    arrays: dict[str, np.ndarray] = {}
    for number, (bone, row) in enumerate(zip(skeleton.bones, rows, strict=True)):
        row["is_scenery"] = not skeleton.is_moved(number)
        row["shapes"] = []
        for shape in bone.shapes:
            name = f"shape_{len(arrays)}"
            mesh = shape_mesh(shape)
            arrays[f"{name}_points"] = mesh.points.astype(np.float32)
            arrays[f"{name}_triangles"] = mesh.triangles.astype(np.uint32)
            light = linear_of(shape.colour[:3]).tolist()
            row["shapes"].append({"array": name, "light": [*light, shape.colour[3]]})
    if skeleton.skin is not None and skeleton.skin.kind == "mesh":
        _add_pieces(skeleton, rows, arrays)
    return rows, arrays


def _add_pieces(
    skeleton: Skeleton, rows: list[dict[str, Any]], arrays: dict[str, np.ndarray]
) -> None:
    """Add the skin of a model to the shapes of its bones: the extension's armatures bend what mass points move alone.

    A triangle is on the bone that its first corner follows most.
    """
    assert skeleton.skin is not None
    mesh = skin_mesh(skeleton)
    main = mesh.main_bones
    light = linear_of(colours_of(skeleton.skin, mesh.shades))
    for part in parts_of(skeleton.skin, mesh).values():
        triangles = mesh.triangles[part]
        bones = main[triangles[:, 0]]
        for number in np.unique(bones).tolist():
            used, corners = np.unique(triangles[bones == number], return_inverse=True)
            points = mesh.points_of(number, used)
            name = f"shape_{len(arrays)}"
            arrays[f"{name}_points"] = points.astype(np.float32)
            arrays[f"{name}_triangles"] = corners.reshape(-1, 3).astype(np.uint32)
            colour = [*light[used[0]].tolist(), 1.0]
            rows[number]["shapes"].append({"array": name, "light": colour})


def main(reference: str) -> None:
    """Write the emulator or policy in a file, `.policy.safetensors` a policy, beside the present work."""
    is_policy = reference.endswith(POLICY_ENDING)
    model = load_policy(reference) if is_policy else Emulator.load(reference)
    name = Path(reference).name.removesuffix(".safetensors").removesuffix(".emulator")
    print(write_npz(model, Path(f"{name}.npz")))


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit("Wanted one file: python blender/npz_file.py my_robot.emulator.safetensors")
    try:
        main(sys.argv[1])
    except (NeuroAnimatorError, OSError) as error:
        sys.exit(str(error))
