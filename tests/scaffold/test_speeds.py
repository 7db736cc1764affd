"""Controls of a step function are narrowed until its angles turn at speeds that are learnt, and that is told."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from neuroanimator import load_system
from neuroanimator.learn.evaluation.held_out import make_test
from neuroanimator.learn.evaluation.speed_function import FUNCTION_STEPS, function_player
from neuroanimator.physics.functions.function_system import PythonSystem
from neuroanimator.scaffold.defaults import BEARABLE, MAX_TURN, SHORT_SUPER_STEP
from neuroanimator.scaffold.function import _fastest_turning, _run_trial
from neuroanimator.scaffold.write_toml import write_definition

WHEEL = """\
import numpy as np
STEP = 0.005
STATE = {{"angle": "rad", "spin": "rad/s"}}
CONTROL = {{"torque": ("N·m", -{torque}, {torque})}}

def step(state, control, dt):
    spin = state[1] + dt * ({gain} * control[0] - {drag} * state[1] - np.sin(state[0]))
    return np.array([state[0] + dt * spin, spin])
"""


WHEELS = {(gain, torque) for gain in (5.0, 40.0) for torque in (0.5, 2.0, 30.0)}

QUICK = {(5.0, 0.5), (40.0, 30.0)}
"""The slowest and the fastest; those between run in `make endurance`."""


@pytest.mark.parametrize(
    ("gain", "torque"),
    [
        *sorted(QUICK),
        *(pytest.param(*wheel, marks=pytest.mark.endurance) for wheel in sorted(WHEELS - QUICK)),
    ],
)
def test_what_turns_too_fast_is_driven_less(gain: float, torque: float, tmp_path: Path):
    path = tmp_path / "wheel.py"
    path.write_text(WHEEL.format(torque=torque, gain=gain, drag=2.0))
    toml, proposal = write_definition(str(path))
    system = load_system(str(toml))
    assert isinstance(system, PythonSystem)
    _, speed = _fastest_turning(_run_trial(system))
    told = [line for line in proposal.warnings if "rad/s in trial runs, too fast" in line]
    is_slow = speed * SHORT_SUPER_STEP <= 1.1 * BEARABLE * MAX_TURN
    assert is_slow or any("even with 0.125" in line for line in told)
    is_narrowed = float(system.bounds.half[0]) < torque
    assert is_narrowed == any("of it is proposed" in line for line in told)
    assert np.allclose(system.bounds.middle, 0)


BANNER = """\
import ctypes, os
import numpy as np
if os.name == "posix":
    puts = ctypes.CDLL(None).puts
else:
    puts = print
puts(b"build time: today")
print("a banner")
STEP = 0.1
STATE = {"x": "m"}
CONTROL = {"push": ("N", -1.0, 1.0)}

def step(state, control, dt):
    print("a step")
    puts(b"WARNING: Nan, Inf or huge value in QACC")
    return np.array([0.9 * state[0] + dt * control[0]])
"""


def test_what_a_step_file_prints_is_kept_out_of_the_results(tmp_path: Path):
    path = tmp_path / "loud.py"
    path.write_text(BANNER)
    program = [sys.executable, "-c", "from neuroanimator.cli.main import main; main()"]
    told = subprocess.run([*program, "new", str(path)], capture_output=True, text=True, check=True)
    for noise in ("build time: today", "a banner", "a step", "WARNING: Nan"):
        assert noise in told.stderr
    rows = told.stdout.splitlines()
    assert [row.split()[0] for row in rows] == ["system", "super", "written", "next"]


def test_a_step_that_prints_does_so_on_stderr_in_python_too(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    path = tmp_path / "loud.py"
    path.write_text(BANNER.replace('os.name == "posix"', "False"))
    write_definition(str(path))
    out, err = capsys.readouterr()
    assert out == ""
    assert "a banner" in err
    assert "a step" in err


def test_a_step_that_prints_does_so_on_stderr_while_it_is_timed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    path = tmp_path / "loud.py"
    path.write_text(BANNER.replace('os.name == "posix"', "False"))
    toml, _ = write_definition(str(path))
    system = load_system(str(toml))
    assert isinstance(system, PythonSystem)
    states = np.random.default_rng(0).normal(size=(4, 11, 1))
    play = function_player(system, make_test(system, 0.1, states, np.zeros((4, 10, 1))))
    capsys.readouterr()
    play()
    out, err = capsys.readouterr()
    assert out == ""
    assert err.count("a step") == FUNCTION_STEPS
