"""Small real data and emulators shared by the tests."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from neuroanimator import Emulator, dataset_config, find_emulator, generate, read_transitions
from neuroanimator.data.transitions import Transitions

Cli = Callable[..., subprocess.CompletedProcess[str]]


@pytest.fixture(scope="session")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with 6,000 transitions of the active pendulum: two shards."""
    folder = tmp_path_factory.mktemp("data") / "pendulum"
    generate(dataset_config(system="pendulum", count=6000), folder)
    return folder


@pytest.fixture(scope="session")
def transitions(dataset: Path) -> Transitions:
    return read_transitions(dataset)


@pytest.fixture(scope="session")
def shipped() -> Emulator:
    return Emulator.load(find_emulator("pendulum-50"))


@pytest.fixture(scope="session")
def cli() -> Cli:
    """Run the real command line in a process of its own."""

    def run(*arguments: object, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
        command = [
            sys.executable,
            "-c",
            "from neuroanimator.cli.main import main; main()",
            *map(str, arguments),
        ]
        environment = {key: value for key, value in os.environ.items() if key != "NEUROANIMATOR_DEBUG"}
        return subprocess.run(command, capture_output=True, text=True, cwd=cwd, env=environment, timeout=300)

    return run
