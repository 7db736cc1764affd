"""Write an emulator or a policy in the format its file name asks for."""

from __future__ import annotations

from pathlib import Path

from neuroanimator.control.policies.state_policy import load_any_policy
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.errors import ArgumentError
from neuroanimator.export.programs.c_file import write_c_header
from neuroanimator.export.programs.definition import Model
from neuroanimator.export.programs.exported_files import ExportedFiles
from neuroanimator.export.programs.onnx_file import write_onnx
from neuroanimator.export.programs.wasm_file import write_wasm
from neuroanimator.files.zoo import find_emulator, find_policy, licence_of

WRITERS = {".h": write_c_header, ".wasm": write_wasm, ".onnx": write_onnx}
"""Writers of programs, by the suffix of the file."""

POLICY_ENDING = ".policy.safetensors"
"""Suffix of policies' files."""


def export_programs(
    reference: str, outs: list[Path], *, is_policy: bool, is_emulator: bool = False
) -> list[ExportedFiles]:
    """Write the emulator or policy `reference`, a name or a file, to each path; nothing if one of them is refused.

    A name means an emulator unless `is_policy`; a file `*.policy.safetensors` is a policy, or with `is_emulator` the
    emulator in it.
    """
    for path in outs:
        if path.suffix not in WRITERS:
            raise ArgumentError(
                f"out: '{path.name}' ends in none of {', '.join(WRITERS)}, the formats of an emulator or a policy. "
                "'animate' writes motions."
            )
    model: Model
    if is_policy or reference.endswith(POLICY_ENDING):
        source = find_policy(reference)
        policy = load_any_policy(source)
        model = policy.emulator if is_emulator else policy
    else:
        source = find_emulator(reference)
        model = Emulator.load(source)
    licence = licence_of(source)
    return [WRITERS[path.suffix](model, path, licence) for path in outs]
