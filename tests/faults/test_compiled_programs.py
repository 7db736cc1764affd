"""What is compiled is loaded only if it is what was written; whatever is wrong with it, callers go on."""

from __future__ import annotations

import ctypes
import os
import shlex
import shutil
import signal
import stat
import subprocess
import sys
import time
from itertools import count
from pathlib import Path

import numpy as np
import pytest
from waiting import PATIENCE

from neuroanimator.codegen import build, compiler, kept
from neuroanimator.codegen.backend import backend_in_words
from neuroanimator.codegen.compiler import compiled_library, compiler_facts, find_compiler
from neuroanimator.codegen.zig import zig_cc
from neuroanimator.files.unfinished import UNFINISHED, remove_stale
from neuroanimator.physics import load_system
from neuroanimator.terminal import warn_once

pytestmark = pytest.mark.skipif(
    find_compiler() is None, reason="no C compiler: nothing is compiled"
)

NUMBERS = count()


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A cache folder of its own, and a process that has compiled nothing yet."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.setattr(compiler, "FLAGS", (("-O0",),))
    forget()
    return tmp_path


def forget() -> None:
    compiler._compiled.cache_clear()
    compiler._given_up.clear()
    build.compiler_version.cache_clear()
    warn_once.cache_clear()


def program() -> tuple[str, int]:
    """Return a C program nobody has compiled, and what its function `it` returns."""
    number = next(NUMBERS)
    return f"int it(void) {{ return {number}; }}\n", number


def does_it(text: str, number: int) -> bool:
    library = compiled_library(text)
    return library is not None and library.it() == number


def libraries(home: Path) -> list[Path]:
    return sorted((home / "neuroanimator" / "compiled").glob("*.so"))


def test_a_program_is_compiled_once_and_found_again_by_another_process(
    home: Path, monkeypatch: pytest.MonkeyPatch
):
    text, number = program()
    assert does_it(text, number)
    (made,) = libraries(home)
    assert stat.S_IMODE(made.parent.stat().st_mode) == 0o700
    forget()
    monkeypatch.setattr(compiler, "_make", lambda *all: pytest.fail("compiled again"))
    assert does_it(text, number)


@pytest.mark.parametrize(
    "damage",
    [
        lambda raw: b"",
        lambda raw: raw[: len(raw) // 2],
        lambda raw: b"\x7fELF" + b"garbage" * 1000,
        lambda raw: raw[:5000] + bytes([raw[5000] ^ 1]) + raw[5001:],
        lambda raw: b"#!/bin/sh\n",
    ],
)
def test_a_damaged_library_is_never_loaded_and_made_again(damage, home: Path):
    text, number = program()
    assert does_it(text, number)
    (made,) = libraries(home)
    whole = made.read_bytes()
    made.unlink()  # this process still has the old one open
    made.write_bytes(damage(whole))
    forget()
    assert does_it(text, number)
    assert made.read_bytes() == whole


def test_a_library_for_another_machine_is_removed_and_made_again(home: Path):
    text, number = program()
    assert does_it(text, number)
    (made,) = libraries(home)
    raw = made.read_bytes()
    foreign = (
        raw[:18] + b"\xb7\x00" + raw[20:] if raw[18] != 0xB7 else raw[:18] + b"\x3e\x00" + raw[20:]
    )
    key = made.name.partition("-")[0]
    made.unlink()
    compiler._path(made.parent, key, foreign).write_bytes(foreign)
    forget()
    assert does_it(text, number)
    assert libraries(home) == [made]


def test_a_folder_of_somebody_else_or_a_link_is_not_used(
    home: Path, tmp_path_factory: pytest.TempPathFactory
):
    elsewhere = tmp_path_factory.mktemp("elsewhere")
    ours = home / "neuroanimator"
    for make in (
        lambda: ours.symlink_to(elsewhere),
        lambda: (ours.mkdir(), ours.chmod(0o777)),
        lambda: (ours.mkdir(), ours.chmod(0o770)),
        lambda: (ours.mkdir(), (ours / "compiled").symlink_to(elsewhere)),
        lambda: ours.write_text("a file"),
        lambda: (
            (ours.mkdir(), os.chown(ours, 1234, 1234))
            if os.getuid() == 0
            else ours.symlink_to(elsewhere)
        ),
    ):
        make()
        forget()
        text, number = program()
        assert does_it(text, number)
        assert not list(home.rglob("*.so"))
        assert not list(elsewhere.iterdir())
        shutil.rmtree(ours) if ours.is_dir() and not ours.is_symlink() else ours.unlink()


def test_a_folder_others_could_swap_is_not_used(home: Path):
    home.chmod(0o777)
    text, number = program()
    assert does_it(text, number)
    assert not (home / "neuroanimator").exists()
    home.chmod(0o700)


@pytest.mark.parametrize("said", ["relative/folder", "/dev/null", "/proc/nothing"])
def test_a_home_that_cannot_be_written_to_costs_nothing(
    said: str, home: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setenv("XDG_CACHE_HOME", said)
    monkeypatch.setenv("HOME", "/proc/nothing")
    text, number = program()
    assert does_it(text, number)


def test_where_programs_may_not_run_another_folder_serves(home: Path):
    if (
        os.getuid() != 0
        or subprocess.run(["mount", "-t", "tmpfs", "-o", "noexec", "none", home]).returncode
    ):
        pytest.skip("only root may mount a disk that programs may not run from")
    try:
        home.chmod(0o700)
        text, number = program()
        assert does_it(text, number)
        assert not libraries(home)
    finally:
        subprocess.run(["umount", home], check=True)


FAILING = {
    "missing": None,
    "a folder": Path("/"),
    "no program": b"\x00\x01 no program",
    "without an end": b"#!/bin/sh\nsleep 600 & sleep 600\n",
    "rubbish": b"#!/bin/sh\nhead -c 200000 /dev/urandom >&2; printf '\\351\\350' >&2; printf '\\351'; exit 1\n",
    "makes nothing": b"#!/bin/sh\nexit 0\n",
}


@pytest.mark.parametrize("kind", FAILING)
def test_a_compiler_that_is_none_costs_one_line(
    kind: str, home: Path, monkeypatch: pytest.MonkeyPatch, capfd
):
    monkeypatch.setattr(build, "PATIENCE", 0.5)
    monkeypatch.setattr(build, "VERSION_PATIENCE", 0.5)
    content = FAILING[kind]
    path = content if isinstance(content, Path) else home / "cc"
    if isinstance(content, bytes):
        path.write_bytes(content)
        path.chmod(0o700)
    monkeypatch.setenv("CC", f"{path} -pipe")
    system = load_system("fish")
    controls = np.zeros((1, 1, system.control.size))
    runs = system.simulate_fastest(
        system.rest[None], controls, 4 * system.physics_dt, system.scheme
    )
    assert np.isfinite(runs.states).all()
    assert [compiled_library(program()[0]) for _ in range(3)] == [None] * 3
    assert len(capfd.readouterr().err.splitlines()) == 1
    assert not list(home.glob("neuroanimator/compiled/*"))


AT_WORK = "i=0; while [ $i -lt 8 ]; do sleep 0.2; n=0; while [ $n -lt 20000 ]; do n=$((n+1)); done; i=$((i+1)); done"


def test_patience_counts_the_compilers_own_time_and_not_that_of_a_busy_machine(tmp_path: Path):
    assert build.succeeds(["sh", "-c", AT_WORK], tmp_path, 1.0)  # it takes twice as long
    for endless in ("while :; do :; done", "sleep 600"):
        with pytest.raises(build.NoCompilerError, match=r"did not end within 0\.3 s"):
            build.succeeds(["sh", "-c", endless], tmp_path, 0.3)


def test_arguments_of_the_compiler_are_heeded(home: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("CC", "cc -DNUMBER=12345")
    library = compiled_library("int it(void) { return NUMBER; }\n")
    assert library is not None
    assert library.it() == 12345


COMPILE = """
import sys
from neuroanimator.codegen import compiler
compiler.FLAGS = (("-O0",),)
print(compiler.compiled_library("int it(void) { return 9; }").it())
"""


def test_many_processes_compile_the_same_thing_at_once(home: Path):
    command = [sys.executable, "-c", COMPILE]
    running = [subprocess.Popen(command, stdout=subprocess.PIPE, text=True) for _ in range(4)]
    assert [process.communicate(timeout=PATIENCE)[0].strip() for process in running] == ["9"] * 4
    assert len(libraries(home)) == 1
    assert len(list(libraries(home)[0].parent.iterdir())) == 1


def test_what_a_killed_compile_left_is_removed_next_time(
    home: Path, monkeypatch: pytest.MonkeyPatch
):
    slow = home / "slow"
    slow.write_text('#!/bin/sh\ncase "$1" in --version) exit 0;; esac\nsleep 20\n')
    slow.chmod(0o700)
    process = subprocess.Popen([sys.executable, "-c", COMPILE], env={**os.environ, "CC": str(slow)})
    folder = home / "neuroanimator" / "compiled"
    while not list(folder.glob(f"{UNFINISHED}*/program.c")):
        time.sleep(0.01)
    (position,) = folder.glob(f"{UNFINISHED}*")
    assert does_it(*program())
    assert position.exists(), "it belongs to a process that lives"
    process.send_signal(signal.SIGKILL)
    process.wait()
    own = folder / f"{UNFINISHED}plans"
    own.mkdir()
    remove_stale(folder)
    assert not position.exists()
    assert own.exists()


@pytest.fixture
def only_zig(home: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A machine without a compiler of its own, on which the extra `[compiler]` is installed."""
    if zig_cc() is None:
        pytest.skip("no Zig: pip install 'neuroanimator[compiler]'")
    monkeypatch.setenv("PATH", str(home))
    monkeypatch.setattr(compiler, "FLAGS", kept.FLAGS)
    monkeypatch.setattr("neuroanimator.codegen.backend._chosen", ["auto"])
    return home


def test_without_a_compiler_of_its_own_a_machine_compiles_by_zig(only_zig: Path):
    assert find_compiler() == shlex.join(zig_cc() or [])
    text = (
        "#include <math.h>\n#include <string.h>\n"
        "void it(const float *x, float *y) { float z[2]; memcpy(z, x, sizeof z); y[0] = powf(z[0], z[1]); }\n"
    )
    library = compiled_library(text)
    assert library is not None
    power = ctypes.c_float()
    library.it((ctypes.c_float * 2)(3, 4), ctypes.byref(power))
    assert power.value == pytest.approx(81)
    facts = compiler_facts()
    assert facts is not None
    assert "clang version" in facts
    assert "zig cc" in backend_in_words()


def test_a_zig_that_fails_costs_one_line(
    only_zig: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    broken = only_zig / "zig"
    broken.write_text(f"#!{sys.executable}\nraise SystemExit(1)\n")
    broken.chmod(0o755)
    monkeypatch.setattr(compiler, "zig_cc", lambda: [str(broken), "cc"])
    for _ in range(2):
        assert compiled_library(program()[0]) is None
    assert capsys.readouterr().err.count("Nothing could be compiled") == 1


def test_without_any_compiler_the_extra_is_named(home: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("PATH", str(home))
    monkeypatch.setattr(compiler, "zig_cc", lambda: None)
    monkeypatch.setattr("neuroanimator.codegen.backend._chosen", ["auto"])
    assert find_compiler() is None
    assert "pip install 'neuroanimator[compiler]'" in backend_in_words()
