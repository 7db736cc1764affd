"""Step functions that answer, and not as they should, are refused in one line; batches are seen."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from neuroanimator import NeuroAnimatorError, load_system
from neuroanimator.scaffold.write_toml import write_definition

SPRING = """\
import numpy as np

STEP = 0.01
STATE = {"place": "m", "speed": "m/s"}
CONTROL = {"force": ("N", -3.0, 3.0)}


def step(state, control, dt):
    speed = state[1] + dt * (control[0] - 9.0 * state[0] - 0.5 * state[1])
    return np.array([state[0] + dt * speed, speed])
"""

ANSWER = "np.array([state[0] + dt * speed, speed])"


def written(folder: Path, *changes: tuple[str, str]):
    source = SPRING
    for old, new in changes:
        assert old in source
        source = source.replace(old, new)
    (folder / "spring.py").write_text(source)
    return write_definition(str(folder / "spring.py"), force=True)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ([("return ", "x = ")], "step returned nothing; wanted numbers of shape (2,)"),
        ([(ANSWER, "speed")], "step returned shape (); wanted"),
        ([(ANSWER, ANSWER + "[:, None]")], "step returned shape (2, 1); wanted"),
        ([(ANSWER, f"{ANSWER}, 0.0, False, {{}}")], "a tuple of ndarray, float, bool, dict; wanted"),
        ([(ANSWER, "{'place': 0.0}")], "step returned a dict; wanted"),
        ([(ANSWER, ANSWER + " + 1j")], "step returned an array of complex128; wanted"),
        ([("dt * (control", "dt * (np.random.normal() + control")], "use no random numbers"),
        (
            [("\n\ndef", "\nN = [0]\n\n\ndef"), ("    return", "    N[0] += 1\n    speed += N[0]\n    return")],
            "from the same state and control. It must keep nothing between calls",
        ),
        ([(ANSWER, "np.array([state[0] + dt * speed, np.nan])")], "returns NaN for speed[0] m/s in the state [0., 0.]"),
        ([(ANSWER, "np.array([state[0] + dt * speed, np.sqrt(speed)])")], "returns NaN for speed[0]"),
        ([("- 9.0", "+ 1e5")], "trial runs under random controls diverged"),
        ([("STEP = 0.01", "STEP = 86400")], "from 1e-08 to 3600 s, got 86400"),
        (
            [("STEP", 'REST = {"place": 5e7}\nSTEP'), ("9.0 * state[0]", "9.0 * (state[0] - 5e7)")],
            "reaches 5e+07; an emulator takes at most 1e+06",
        ),
    ],
)  # fmt: skip
def test_a_wrong_answer_is_told_in_one_line(
    tmp_path: Path, changes: list[tuple[str, str]], message: str
):
    with pytest.raises(NeuroAnimatorError) as caught:
        written(tmp_path, *changes)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)
    assert str(caught.value).startswith("spring.py: ")


@pytest.mark.parametrize(
    "answer",
    [
        ANSWER,
        ANSWER[9:-1],  # a list
        "(state[0] + dt * speed, speed)",
        f"{ANSWER}.astype(np.float32)",
        "state.__iadd__(np.array([dt * speed, speed - state[1]]))",  # in place
    ],
)
def test_any_numbers_of_the_right_shape_will_do(tmp_path: Path, answer: str):
    toml, _ = written(tmp_path, (ANSWER, answer))
    system = load_system(str(toml))
    start = np.array([[0.5, 0.0]])
    runs = system.simulate(start, np.zeros((1, 3, 1)), 0.01)
    np.testing.assert_array_equal(start, [[0.5, 0.0]])
    assert (np.diff(runs.states[0, :, 0]) < 0).all()


@pytest.mark.parametrize(
    ("changes", "is_batched"),
    [
        ([], True),
        ([("9.0 * state[0]", "9.0 * state[0].mean()")], False),
        ([("    speed =", "    if state[0] > 5: return state\n    speed =")], False),
        ([("STEP", "BATCHED = False\nSTEP")], False),
    ],
)
def test_batches_are_seen_unless_the_file_says_otherwise(
    tmp_path: Path, changes: list[tuple[str, str]], is_batched: bool
):
    _, proposal = written(tmp_path, *changes)
    assert proposal.definition.batched == is_batched


def test_a_slow_function_is_named_before_anybody_waits_for_it(tmp_path: Path):
    slow = "    import time; time.sleep(0.002)\n    if state[0] > 5: return state\n    speed ="
    step = ("STEP = 0.01", 'SPREAD = {"place": 1.0, "speed": 3.0}\nSTEP = 0.01')
    _, proposal = written(tmp_path, step, ("    speed =", slow))
    assert "300,000 transitions take about" in proposal.warnings[-1]
    assert "generate --count" in proposal.warnings[-1]


def test_changes_that_rounding_hides_are_named(tmp_path: Path):
    _, proposal = written(tmp_path, ("control[0] -", "1e-9 * control[0] -"))
    assert "state.place[0] m: changes by" in proposal.warnings[0]
