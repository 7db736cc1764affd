"""Small real data and emulators shared by the tests."""

from __future__ import annotations

import gc
import io
import json
import os
import re
import resource
import subprocess
import sys
from collections import Counter
from collections.abc import Callable, Iterator
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING

from instruction_sets import choose_instruction_set

# One thread of BLAS as well, which reads this when NumPy is imported: those of two processes on two cores wait for each
# other, which took an eighth of the tests' time.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# Most of the tests' time went into compiling programs that run once. Unoptimised they compile in a fifth of the time;
# processes the tests start inherit it. `XLA_FLAGS= make test` compiles as users do.
# One thread a compilation: there is a process for every core already.
XLA_FLAGS = "--xla_backend_optimization_level=0 --xla_cpu_parallel_codegen_split_count=1"
if version("jax").startswith("0.10."):
    XLA_FLAGS += " --xla_cpu_use_fusion_emitters=false"  # later ones end the process over it
os.environ.setdefault("XLA_FLAGS", XLA_FLAGS)
choose_instruction_set()

import numpy as np
import pytest
from shapes import check_shapes
from tally import Tally, tally_line
from waiting import PATIENCE

if TYPE_CHECKING:
    from serving import Serving

    from neuroanimator import Emulator
    from neuroanimator.learn.data.store import Transitions

# Cutting JAX' own frames out of tracebacks takes ten times as long as refusing a file does.
os.environ.setdefault("JAX_TRACEBACK_FILTERING", "off")
# Emulators that tests train live for one test: their programs in C would take longer to make than to run.
# tests/emulator/test_c_emulator.py and the examples run in C; `NEUROANIMATOR_BACKEND=auto make test` runs all of it so.
os.environ.setdefault("NEUROANIMATOR_BACKEND", "jax")

MAX_GROWTH = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") // 6
"""So much may a process grow until it forgets what JAX compiled: two of them fill a third of the memory [bytes]."""

RESIDENT = pytest.StashKey[int]()
"""What a process held when it had last forgotten that [bytes]."""

# What Python compiles is kept, in these processes and in those they start, whatever else the environment asks for: half
# of what collecting the tests takes goes into compiling them, and the package with its checks.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False

# Before anything of the package is imported: what is imported already is not checked. Nothing is imported here, but
# where it is used: the process that only hands tests out to the others has no use for it.
check_shapes()

# While modules are imported all that is made stays, so looking for garbage finds none.
gc.disable()

Cli = Callable[..., subprocess.CompletedProcess[str]]

LONG_FILES = (
    "test_examples.py",
    "test_train.py",
    "test_wheel.py",
    "test_run_table.py",
    "test_documentation.py",
    "test_model.py",
    "test_policy.py",
)
"""Where the longest tests are. They begin first, so that at the end no process waits long for the other's last."""

FAULT_NAME = re.compile(r"test_f\d\d_")
"""Tests of faults that lie beside their subject."""

ATTACK_NAME = re.compile(r"test_s\d\d_")
"""Tests of attacks that lie beside their subject."""


@pytest.fixture
def tally(record_property: Callable[[str, object], None]) -> Tally:
    """Count what a test of faults or attacks tries; one if it does not say."""
    counted = Tally()
    record_property("tally", counted.counts)
    return counted


def pytest_collection() -> None:
    """Keep what JAX compiles, for tests that neither load nor train an emulator, too."""
    from neuroanimator.codegen.jax_settings import keep_programs

    keep_programs()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark tests of faults and attacks, by their folder or their name, and put the longest first."""
    items.sort(key=lambda item: item.path.name not in LONG_FILES)
    for item in items:
        folder = item.path.parent.name
        if folder == "attacks" or ATTACK_NAME.match(item.name):
            item.add_marker(pytest.mark.attack)
        elif folder == "faults" or FAULT_NAME.match(item.name):
            item.add_marker(pytest.mark.fault)


def pytest_collection_finish() -> None:
    """Look for garbage again, though seldom and not among modules: it took a tenth of the tests' time."""
    gc.freeze()
    gc.set_threshold(20_000, 20, 100)
    gc.enable()


@pytest.hookimpl(trylast=True)
def pytest_runtest_teardown(item: pytest.Item, nextitem: pytest.Item | None) -> None:
    """Forget what JAX compiled once it takes much memory: a process grew to six gigabytes of it.

    What a later test needs again is read from the disk. That takes time, too, and the longest tests of all files come first.
    """
    if "jax" in sys.modules and resident_bytes() > item.config.stash.get(RESIDENT, 0) + MAX_GROWTH:
        sys.modules["jax"].clear_caches()
        item.config.stash[RESIDENT] = resident_bytes()


def resident_bytes() -> int:
    """Return the memory that this process holds; 0 where the system does not say."""
    try:
        return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize()
    except OSError:
        return 0


@pytest.hookimpl(trylast=True)
def pytest_unconfigure(config: pytest.Config) -> None:
    """Say as the last line of all how many faults and attacks were tried and survived, and how many bytes were lost."""
    reporter = config.pluginmanager.get_plugin("terminalreporter")
    if reporter is not None and not hasattr(config, "workerinput"):
        line = tally_line(reporter.stats)
        if line:
            reporter.write_line(line)


@pytest.fixture(scope="session")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with 6,000 transitions of the active pendulum: two shards."""
    from neuroanimator import DatasetConfig, generate

    folder = tmp_path_factory.mktemp("data") / "pendulum"
    generate(DatasetConfig(system="pendulum", count=6000), folder)
    return folder


@pytest.fixture(scope="session")
def transitions(dataset: Path) -> Transitions:
    from neuroanimator import read_transitions

    return read_transitions(dataset)


@pytest.fixture(scope="session")
def shipped() -> Emulator:
    from neuroanimator import load_emulator

    return load_emulator("pendulum-50")


@pytest.fixture(scope="session")
def untrained_cube() -> Emulator:
    """A soft body on the ground that is pushed about. None ships; for laws that hold of any weights."""
    from neuroanimator import DatasetConfig, TrainingConfig
    from neuroanimator.learn.data.generate import simulate_transitions
    from neuroanimator.learn.training.initialise import build_emulator

    transitions = simulate_transitions(DatasetConfig(system="cube", count=360, samples_per_run=36))
    config = TrainingConfig(
        network="linear-glu", widths=(16, 8), position_modes=18, velocity_modes=18
    )
    return build_emulator(transitions, config)


@pytest.fixture
def cli(monkeypatch: pytest.MonkeyPatch) -> Cli:
    """Run the command line in this process: without seconds of imports, and all else as `cli_process` does."""
    from neuroanimator import terminal
    from neuroanimator.cli import main as command_line
    from neuroanimator.physics.rigid import warnings as mujoco_warnings

    def run(*arguments: object, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
        words = [str(argument) for argument in arguments]
        out, err = captured(), captured()
        with monkeypatch.context() as changed:
            changed.setattr(sys, "argv", ["neuroanimator", *words])
            changed.setattr(sys, "stdout", out)
            changed.setattr(sys, "stderr", err)
            changed.setattr(terminal._screen, "shows_phases", False)
            # How soon progress is told depends on the machine; tests count the other lines.
            changed.setattr(terminal, "QUIET_FOR", 3600.0)
            changed.setattr(terminal, "_clock", terminal._Clock())
            changed.setattr(mujoco_warnings, "_heard", Counter())
            changed.delenv("NEUROANIMATOR_DEBUG", raising=False)
            changed.chdir(cwd or Path.cwd())
            code = exit_code(command_line._run)
        return subprocess.CompletedProcess(words, code, text_in(out), text_in(err))

    return run


def exit_code(call: Callable[[], None]) -> int:
    """Return the code a process would end with that did nothing but `call`."""
    try:
        call()
    except SystemExit as end:
        return int(end.code or 0)
    return 0


def captured() -> io.TextIOWrapper:
    """Return a stream such as a process has that writes into a pipe."""
    return io.TextIOWrapper(io.BytesIO(), encoding="utf-8", write_through=True)


def text_in(stream: io.TextIOWrapper) -> str:
    """Return what was written into a `captured` stream."""
    buffer = stream.buffer
    assert isinstance(buffer, io.BytesIO)
    return buffer.getvalue().decode()


@pytest.fixture(scope="session")
def cli_process() -> Cli:
    """Run the command line in a process of its own, which knows nothing yet and trusts nobody."""

    def run(*arguments: object, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
        command = [
            sys.executable,
            "-c",
            "from neuroanimator import terminal; terminal.QUIET_FOR = 3600.0\n"
            "from neuroanimator.cli.main import main; main()",
            *map(str, arguments),
        ]
        environment = {
            key: value for key, value in os.environ.items() if key != "NEUROANIMATOR_DEBUG"
        }
        return subprocess.run(
            command, capture_output=True, text=True, cwd=cwd, env=environment, timeout=PATIENCE
        )

    return run


@pytest.fixture(scope="session")
def studio(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Serving]:
    """One studio for all tests that do not change what it allows."""
    from serving import serving

    with serving(tmp_path_factory.mktemp("studio")) as running:
        yield running


def read_glb(path: Path) -> tuple[dict, bytes]:
    """Return the JSON document and the binary chunk of a GLB file."""
    raw = path.read_bytes()
    magic, version, total, length = np.frombuffer(raw[:16], "<u4")
    assert (magic, version, total) == (0x46546C67, 2, len(raw))
    return json.loads(raw[20 : 20 + length]), raw[20 + length + 8 :]


def accessor(document: dict, binary: bytes, index: int) -> np.ndarray:
    """Return the numbers (count, K) accessor `index` points to."""
    entry = document["accessors"][index]
    width = {"SCALAR": 1, "VEC3": 3, "VEC4": 4, "MAT4": 16}[entry["type"]]
    kinds = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
    kind = np.dtype(kinds[entry["componentType"]])
    if "bufferView" not in entry:
        return np.zeros((entry["count"], width), kind)
    view = document["bufferViews"][entry["bufferView"]]
    data = np.frombuffer(binary[view["byteOffset"] : view["byteOffset"] + view["byteLength"]], kind)
    stride = view.get("byteStride", width * kind.itemsize) // kind.itemsize
    numbers = data.reshape(-1, stride)[: entry["count"], :width]
    if entry.get("normalized"):
        return numbers / np.iinfo(kind).max
    return numbers
