"""A bundle: a folder with all that the page needs to show one emulator, and to run it without Python."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

import neuroanimator
from neuroanimator import BadFileError, Emulator, Policy, System, load_policy
from neuroanimator.authoring import (
    SHIPPED_SYSTEMS,
    DeformableSystem,
    checked_wasm,
    commands_of,
    definition_of,
    facts_of_emulator,
    find_emulator,
    licence_of,
    load_any_policy,
    replayable_system,
    shipped_path,
    shipped_policy,
    write_whole,
)
from neuroanimator.control.policies import StatePolicy
from neuroanimator_studio.catalogue import BUNDLE, EMULATOR_WASM, PHYSICS_WASM
from neuroanimator_studio.descent_module import descent_module
from neuroanimator_studio.descents import DESCENT_FILE, descent_of, describe_descent
from neuroanimator_studio.description import describe_emulator, describe_policy, short_numbers
from neuroanimator_studio.opening import opening_drive
from neuroanimator_studio.physics import write_physics_beside


def make_bundle(
    reference: str,
    folder: Path,
    bundle_id: str = "",
    progress: Callable[[str], None] = lambda phase: None,
    known: Sequence[Path] = (),
) -> Path:
    """Write the bundle of the emulator `reference`, a name or a file, into `folder`; return it.

    `progress` is told what is going on. What takes long is copied if one of the bundles `known` is of the same emulator,
    as where a policy's file is dropped that was trained through one that ships.

    Raises ResourceError without Zig and wasmtime, BadFileError for a file that is no emulator, and whatever else
    `write_wasm` raises. What says it is a bundle is written last.
    """
    source = find_emulator(reference)
    emulator, policy = load_models(source)
    licence = licence_of(source)
    folder.mkdir(parents=True, exist_ok=True)
    progress("compiling")
    drive = None
    twin = _bundle_of(digest(emulator), known)
    if twin is None:
        _compile(emulator, folder, licence)
    else:
        drive = _copied(twin, folder)
    if policy is not None:
        progress("compiling its policy")
        policy_wasm = checked_wasm(policy, definition_of(policy, licence), "policy").content
        write_whole(folder / "policy.wasm", policy_wasm)
    progress("looking for a motion to show")
    name = bundle_id or source.name.split(".")[0]
    write_facts(bundle_facts(source, emulator, policy, name, drive), folder)
    return folder


def digest(emulator: Emulator) -> str:
    """Return the SHA-256 of all that `emulator` does: its facts and weights, whatever file they are in."""
    return hashlib.sha256("\n".join(facts_of_emulator(emulator)).encode()).hexdigest()


def _bundle_of(wanted: str, known: Sequence[Path]) -> Path | None:
    """Return the folder of a bundle by this version of the emulator with the digest `wanted`; None if there is none."""
    for folder in known:
        facts = json.loads((folder / BUNDLE).read_text(encoding="ascii"))
        is_current = facts.get("version") == neuroanimator.__version__
        if is_current and facts.get("digest") == wanted:
            return folder
    return None


def _copied(twin: Path, folder: Path) -> dict[str, Any]:
    """Copy the programs of an emulator's bundle into `folder`, and return the motion it is shown with."""
    for name in (EMULATOR_WASM, DESCENT_FILE, PHYSICS_WASM):
        if (twin / name).is_file():
            write_whole(folder / name, (twin / name).read_bytes())
    facts = json.loads((twin / BUNDLE).read_text(encoding="ascii"))
    return facts["default_motion"]


def _compile(emulator: Emulator, folder: Path, licence: str) -> None:
    """Write the programs of an emulator into `folder`: that of super steps, and beside it those of a descent and of physics."""
    system = replayable_system(emulator)
    with ThreadPoolExecutor() as pool:
        others = [
            pool.submit(_compile_descent, emulator, system, folder),
            pool.submit(write_physics_beside, system, emulator.dt, folder),
        ]
        # Descents have programs of their own; the page asks for no other gradient.
        module = checked_wasm(
            emulator, definition_of(emulator, licence), "emulator", has_gradient=False
        )
        write_whole(folder / EMULATOR_WASM, module.content)
        for other in others:
            other.result()


def _compile_descent(emulator: Emulator, system: System, folder: Path) -> None:
    descent = descent_of(emulator, system)
    if descent is not None:
        write_whole(folder / DESCENT_FILE, descent_module(descent))


def write_facts(facts: dict[str, Any], folder: Path) -> None:
    """Write what a bundle says into its `folder`."""
    text = json.dumps(facts, allow_nan=False, ensure_ascii=True, separators=(",", ":"))
    write_whole(folder / BUNDLE, text.encode("ascii"))


class Models(NamedTuple):
    """What a file has in it."""

    emulator: Emulator
    policy: Policy | StatePolicy | None


def load_models(source: Path) -> Models:
    """Return the emulator in a file, and its policy: the one that ships with it, or all of a policy's file.

    Raises BadFileError for a file that is neither; it says what is wrong with it as an emulator. So it does for a state policy
    that takes no commands: nobody could steer it.
    """
    try:
        emulator = Emulator.load(source)
    except BadFileError:
        try:
            policy = load_any_policy(source)
        except BadFileError:
            policy = None
        if policy is None:
            raise
        if isinstance(policy, StatePolicy) and commands_of(policy) is None:
            raise BadFileError(
                f"{source} is a policy that takes no commands, and the page steers by them. Learn one whose TOML file has "
                "[follow.commands]."
            ) from None
        return Models(policy.emulator, policy)
    return Models(emulator, policy_beside(source, emulator))


def walk_drive(policy: StatePolicy) -> dict[str, Any]:
    """Return the start of a body that follows a motion on command; from there on its policy drives it, in the page."""
    reference = policy.view.reference
    assert reference is not None
    return {"start": short_numbers(reference.begun(0.0)), "controls": []}


def policy_beside(source: Path, emulator: Emulator) -> Policy | None:
    """Return the policy that ships with the emulator at `source`; None where there is none."""
    name = emulator.system
    shipped = SHIPPED_SYSTEMS.get(name)
    if (
        shipped is None
        or not shipped.has_policy
        or source != shipped_path(name, shipped.substeps[0])
    ):
        return None
    return load_policy(shipped_policy(name))


def bundle_facts(
    source: Path,
    emulator: Emulator,
    policy: Policy | StatePolicy | None,
    bundle_id: str,
    drive: dict[str, Any] | None = None,
) -> dict[str, Any]:
    """Return what `bundle.json` says; `drive` is what to show first, found if not given."""
    system = replayable_system(emulator)
    facts: dict[str, Any] = {"id": bundle_id}
    facts |= describe_emulator(emulator, system)
    facts["sha256"] = hashlib.sha256(source.read_bytes()).hexdigest()
    facts["digest"] = digest(emulator)
    facts["licence"] = licence_of(source)
    facts["policy"] = None if policy is None else describe_policy(policy)
    if isinstance(policy, StatePolicy):
        drive = walk_drive(policy)
    elif drive is None:
        opening = opening_drive(emulator, system)
        drive = {
            "start": short_numbers(opening.start),
            "controls": short_numbers(opening.controls),
        }
    facts["default_motion"] = drive
    facts["emulator"] = EMULATOR_WASM
    facts["physics"] = PHYSICS_WASM if isinstance(system, DeformableSystem) else None
    descent = descent_of(emulator, system)
    facts["descents"] = [] if descent is None else [describe_descent(descent, system)]
    return facts
