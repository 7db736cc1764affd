"""The emulators on show: those that ship, and those somebody dropped on the page, kept for the next time."""

from __future__ import annotations

import hashlib
import re
import shutil
import subprocess
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from threading import Lock, Timer

from neuroanimator import (
    ArgumentError,
    BadFileError,
    Emulator,
    NeuroAnimatorError,
    ResourceError,
    System,
    load_system,
)
from neuroanimator.authoring import (
    EmulatorSpec,
    find_emulator,
    private_folders,
    python_command,
    replayable_system,
)
from neuroanimator_studio.bundle_worker import FAULT, PHASE
from neuroanimator_studio.catalogue import (
    BUNDLE,
    EMULATOR,
    PHYSICS_BUNDLES,
    SHIPPED_BUNDLES,
    shipped_bundles,
)
from neuroanimator_studio.physics import physics_spec

OWN_ID = re.compile(r"[0-9a-f]{16}")
"""The id of a bundle that does not ship: how the hash of its emulator's file begins."""

ID_LENGTH = 16
"""Letters of such an id."""

KEPT = 20
"""Bundles that are kept; of more the oldest go."""

MAX_MAKING = 600.0
"""Time after which making a bundle is given up [s]."""

WORKER = "neuroanimator_studio.bundle_worker"
"""The module that makes bundles, in a process of its own: a stranger's file may take all memory there is."""

LOADED = 8
"""Emulators held in memory with their physics."""

Progress = Callable[[str], None]
"""Is told what is going on."""


@dataclass(frozen=True, eq=False)
class Shown:
    """What is on show, and the physics it stands for."""

    bundle_id: str
    spec: EmulatorSpec
    system: System
    emulator: Emulator | None
    """None where the page runs the physics itself."""


class Library:
    """Bundles by their ids, those of the user's own in a folder nobody else can write to."""

    def __init__(self, folder: Path | None = None):
        """`folder` is where own bundles are kept; the user's cache if not given."""
        self.folder = folder or _kept_folder()
        self._loading = Lock()
        self._making = Lock()
        self._load = lru_cache(LOADED)(self._load_now)

    def bundles(self) -> list[Path]:
        """Return the folders of all bundles, those that ship first."""
        own = [
            path.parent for path in self.folder.glob(f"*/{BUNDLE}") if is_own_id(path.parent.name)
        ]
        return [*shipped_bundles(), *sorted(own, key=_age)]

    def folder_of(self, bundle_id: str) -> Path | None:
        """Return the folder of a bundle; None if there is none of that id."""
        for folder in self.bundles():
            if folder.name == bundle_id:
                return folder
        return None

    def emulator_file(self, bundle_id: str) -> Path:
        """Return the file of a bundle's emulator; ArgumentError if there is no such bundle."""
        if bundle_id in SHIPPED_BUNDLES:
            return find_emulator(bundle_id)
        folder = self.folder_of(bundle_id)
        if folder is None:
            raise ArgumentError("bundle: none has this id. Reload the page.")
        return folder / EMULATOR

    def load(self, bundle_id: str) -> Shown:
        """Return a bundle's physics, and its emulator if it has one; ArgumentError if there is no such bundle."""
        with self._loading:
            return self._load(bundle_id)

    def _load_now(self, bundle_id: str) -> Shown:
        if bundle_id in PHYSICS_BUNDLES:
            system = load_system(bundle_id)
            return Shown(bundle_id, physics_spec(system), system, None)
        emulator = _load_emulator(self.emulator_file(bundle_id))
        return Shown(bundle_id, emulator.spec, replayable_system(emulator), emulator)

    def add(self, file: Path, progress: Progress = lambda phase: None) -> str:
        """Make the bundle of the emulator `file`, unless it is there, and return its id.

        Raises BadFileError, which calls it "the file", for one that is neither an emulator nor a policy, or where it
        cannot be compiled here.
        """
        content = file.read_bytes()
        bundle_id = hashlib.sha256(content).hexdigest()[:ID_LENGTH]
        folder = self.folder / bundle_id
        with self._making:
            if (folder / BUNDLE).is_file():
                (folder / BUNDLE).touch()
                return bundle_id
            progress("reading")
            _check_file(file)
            folder.mkdir(mode=0o700, exist_ok=True)
            (folder / EMULATOR).write_bytes(content)
            try:
                _make(folder / EMULATOR, folder, bundle_id, progress)
            except NeuroAnimatorError:
                shutil.rmtree(folder, ignore_errors=True)
                raise
            self._forget_oldest()
        return bundle_id

    def _forget_oldest(self) -> None:
        own = [folder for folder in self.bundles() if is_own_id(folder.name)]
        for folder in own[:-KEPT]:
            shutil.rmtree(folder, ignore_errors=True)


def is_own_id(bundle_id: str) -> bool:
    """Return whether this may be the id of a bundle that does not ship."""
    return OWN_ID.fullmatch(bundle_id) is not None


def _kept_folder() -> Path:
    for folder in private_folders("studio"):
        own = folder / "bundles"
        own.mkdir(mode=0o700, exist_ok=True)
        return own
    raise ResourceError(
        "No folder to keep bundles in that only you can write to. Set XDG_CACHE_HOME to one."
    )


def _age(folder: Path) -> float:
    return (folder / BUNDLE).stat().st_mtime


def _check_file(file: Path) -> None:
    """Refuse what is neither an emulator nor a policy, in words that do not say where the file lies."""
    try:
        _load_emulator(file)
    except BadFileError as error:
        raise BadFileError(str(error).replace(str(file), "The file")) from error


def _load_emulator(file: Path) -> Emulator:
    """Return the emulator in a file; of a policy the one it was trained through."""
    try:
        return Emulator.load(file)
    except BadFileError:
        # It takes time to import, and nearly all files are emulators.
        from neuroanimator_studio.bundle import load_models

        return load_models(file).emulator


def _make(source: Path, folder: Path, bundle_id: str, progress: Progress) -> None:
    """Make a bundle in a process of its own; errors are its, without the names of folders."""
    command = python_command("-m", WORKER, str(source), str(folder), bundle_id)
    fault = "it took too long, or too much memory"
    with subprocess.Popen(
        command,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    ) as process:
        alarm = Timer(MAX_MAKING, process.kill)
        alarm.daemon = True
        alarm.start()
        try:
            assert process.stdout is not None
            for line in process.stdout:
                kind, _, words = line.rstrip("\n").partition(" ")
                if kind == PHASE:
                    progress(words)
                elif kind == FAULT:
                    fault = words
            code = process.wait()
        finally:
            alarm.cancel()
            process.kill()
    if code != 0:
        said = fault.replace(str(source), "The file").replace(str(folder), "the bundle")
        raise BadFileError(f"No bundle could be made of it: {said}")
