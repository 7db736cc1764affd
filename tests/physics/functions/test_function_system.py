"""A Python step function becomes a system, an emulator and an evaluation; a stranger's never runs."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import numpy as np
import pytest
from conftest import Cli
from small_trainings import small_training

from neuroanimator import (
    DatasetConfig,
    Emulator,
    NeuroAnimatorError,
    TrainingConfig,
    evaluate,
    generate,
    load_system,
    read_transitions,
    train,
    write_report,
)
from neuroanimator.files.atomic import canonical_json
from neuroanimator.learn.evaluation.evaluate import EvaluationBudget
from neuroanimator.learn.evaluation.speed_function import function_schemes
from neuroanimator.physics.functions.function_system import PythonSystem
from neuroanimator.physics.loading import resolve, trust_files
from neuroanimator.scaffold.write_toml import write_definition

FAST = EvaluationBudget(runs=4, transitions=100, repeats=1, starts=20, steps=50)

SPRING = """\
import numpy as np

STEP = 0.01
STATE = {"place": "m", "speed": "m/s"}
CONTROL = {"force": ("N", -3.0, 3.0)}
RATES = {"place": "speed"}
ODE = True
SPREAD = {"place": 1.0, "speed": 2.0}
BATCHED = True


def step(state, control, dt):
    speed = state[1] + dt * (control[0] - 9.0 * state[0] - 0.5 * state[1])
    return np.array([state[0] + dt * speed, speed])
"""


def system_from(folder: Path, source: str = SPRING, name: str = "spring") -> PythonSystem:
    path = folder / f"{name}.py"
    path.write_text(source)
    toml, _ = write_definition(str(path), force=True)
    system = load_system(*resolve(str(toml))[:2])
    assert isinstance(system, PythonSystem)
    return system


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with spring.py, spring.toml, data and a briefly trained emulator."""
    folder = tmp_path_factory.mktemp("spring")
    system = system_from(folder)
    config = DatasetConfig(
        system=system.name,
        definition=system.definition_text,
        substeps=10,
        count=3024,
        samples_per_run=36,
    )
    generate(config, folder / "data")
    settings = TrainingConfig(updates=500, widths=(24, 24), batch=128)
    train(read_transitions(folder / "data"), settings, folder / "spring.emulator.safetensors")
    return folder


def test_a_run_is_the_function_called_again_and_again(tmp_path: Path):
    system = system_from(tmp_path)
    start, controls = np.array([[0.5, -1.0]]), np.array([[[1.0], [-2.0], [0.5]]])
    found = system.simulate(start, controls, 0.05, scheme=system.scheme).states[0]
    state = start[0]
    for t in range(3):
        for _ in range(5):
            state = system.function(state, controls[0, t], 0.01)
        np.testing.assert_allclose(found[t + 1], state, rtol=1e-12)


def test_rows_one_by_one_and_in_batches_are_the_same(tmp_path: Path):
    batched = system_from(tmp_path)
    alone = system_from(tmp_path, SPRING.replace("BATCHED = True", "BATCHED = False"), "alone")
    rng = np.random.default_rng(0)
    starts, controls = batched.sample_starts(rng, 7), rng.uniform(-3, 3, (7, 4, 1))
    runs = [system.simulate(starts, controls, 0.1).states for system in (batched, alone)]
    np.testing.assert_allclose(*runs, rtol=1e-12)
    assert not np.array_equal(runs[0][0], runs[0][1])


def test_a_function_is_the_truth_at_its_own_step_unless_it_says_that_it_integrates_an_equation(
    tmp_path: Path,
):
    system = system_from(tmp_path, SPRING.replace("ODE = True\n", ""), "plain")
    assert system.truth == system.fine == system.scheme
    text = (tmp_path / "plain.toml").read_text()
    assert "truth_step = 0.01 # the function at its own step is the truth." in text
    assert "ODE = True in plain.py" in text
    integrated = system_from(tmp_path)
    assert integrated.fine.dt == pytest.approx(integrated.scheme.dt / 10)


def test_an_evaluation_says_that_the_function_at_its_own_step_is_the_truth(tmp_path: Path):
    system = system_from(tmp_path, SPRING.replace("ODE = True\n", ""))
    config = DatasetConfig(
        system=system.name, definition=system.definition_text, substeps=10, count=600
    )
    generate(config, tmp_path / "data")
    settings = TrainingConfig(updates=250, widths=(8,), batch=64)
    emulator = train(read_transitions(tmp_path / "data"), settings, tmp_path / "e.safetensors")
    found = evaluate(emulator, budget=FAST)
    assert found.is_own_reference
    assert "measured against the physics at its own step, which is the truth" in found.note
    write_report([found], tmp_path / "report.html")
    report = (tmp_path / "report.html").read_text()
    assert "which is the truth here" in report
    assert "strays from" not in report


def test_a_function_that_fails_at_a_smaller_step_is_never_called_with_one(tmp_path: Path):
    source = SPRING.replace("ODE = True\n", "").replace("dt):\n", "dt):\n    assert dt >= 0.01\n")
    system = system_from(tmp_path, source, "coarse")
    found = function_schemes(system, 0.1, (1, 2, 5, 10, 20, 50))
    assert sorted(round(scheme.dt, 6) for scheme in found) == [0.01, 0.02, 0.05, 0.1]


def test_a_function_that_ignores_dt_cannot_be_an_equation(tmp_path: Path):
    with pytest.raises(NeuroAnimatorError, match="ODE: step gives the same result for every dt"):
        system_from(
            tmp_path, SPRING.replace("control, dt):", "control, dt):\n    dt = 0.01"), "fixed"
        )


def test_a_run_that_diverges_is_told_from_one_that_does_not(tmp_path: Path):
    system = system_from(
        tmp_path,
        SPRING.replace("control[0] -", "control[0] + 1e-3 * np.abs(state[0]) ** 3 -"),
        "wild",
    )
    runs = system.simulate(
        np.array([[1e-3, 0.0], [1e6, 0.0]]), np.zeros((2, 3, 1)), 0.1, scheme=system.scheme
    )
    assert runs.has_diverged.tolist() == [False, True]


def test_an_emulator_of_a_function_is_accurate_and_measured_against_that_function(folder: Path):
    trust_files(folder / "spring.toml")
    emulator = Emulator.load(folder / "spring.emulator.safetensors")
    found = evaluate(emulator, data=read_transitions(folder / "data"), budget=FAST)
    assert found.one_step_error < 0.05
    assert found.diverged == 0
    assert found.speed.physics == "Python function"
    assert found.speed.equal_error_opponent.error <= found.one_step_error
    assert "not compiled" in found.note
    write_report([found], folder / "report.html")
    assert "Python function" in (folder / "report.html").read_text()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            ("STEP = 0.01", ""),
            "broken.py: STEP: wanted a line like `STEP = 0.01`, from 1e-08 to 3600 s, got nothing",
        ),
        (("STATE = ", "STATES = "), "STATE: wanted a line like"),
        (('"m/s"}', '"knots"}'), "state.speed: unknown unit 'knots'. Convert to one of: 1, m, m/s"),
        (('("N", -3.0, 3.0)', '("N", 3.0)'), "CONTROL: wanted a line like"),
        (('("N", -3.0, 3.0)', '("N", 3.0, -3.0)'), "control.force: wanted as many numbers"),
        (
            ('{"place": "speed"}', '{"plaice": "speed"}'),
            "RATES: no part 'plaice' in STATE. Parts: place, speed",
        ),
        (("def step", "def stepp"), "wanted a function `def step(state, control, dt)"),
        (("    speed = ", "    spee d = "), "broken.py, line 13: invalid syntax"),
        (("control[0]", "control[1]"), "broken.py, line 13: IndexError: index 1 is out of bounds"),
        (("[state[0] + dt * speed, speed]", "[speed]"), "broken.py: step returned shape"),
        (("ODE = True", "ODE = 1"), "broken.py: ODE: wanted a line like `ODE = True`, got 1"),
        (
            ("import numpy as np", "import numpy as np\nimport sys\nsys.exit(4)"),
            "broken.py, line 3: SystemExit: 4",
        ),
        (
            ("import numpy as np", "import numpy as np\nraise GeneratorExit(4)"),
            "broken.py, line 2: GeneratorExit: 4",
        ),
        (
            ("    speed = ", "    raise BaseException('tired')\n    speed = "),
            "broken.py, line 13: BaseException: tired",
        ),
    ],
)
def test_a_fault_in_the_file_is_told_in_one_line(
    tmp_path: Path, change: tuple[str, str], message: str
):
    with pytest.raises(NeuroAnimatorError) as caught:
        system_from(tmp_path, SPRING.replace(*change), "broken")
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_ctrl_c_in_a_step_is_no_fault_of_its(tmp_path: Path):
    with pytest.raises(KeyboardInterrupt):
        system_from(
            tmp_path,
            SPRING.replace("    speed = ", "    raise KeyboardInterrupt\n    speed = "),
            "slow",
        )


@pytest.mark.parametrize("raised", ["KeyboardInterrupt", "SystemExit(0)", "GeneratorExit"])
def test_what_a_step_raises_itself_is_a_fault_of_its_on_the_command_line(
    raised: str, tmp_path: Path, cli_process: Cli
):
    """There Ctrl-C is a signal, so that even a KeyboardInterrupt is the function's own."""
    text = SPRING.replace("    speed = ", f"    raise {raised}\n    speed = ")
    (tmp_path / "spring.py").write_text(text)
    ended = cli_process("new", "spring.py", cwd=tmp_path)
    (line,) = [line for line in ended.stderr.splitlines() if line.startswith("neuroanimator: ")]
    assert ended.returncode == 3, ended.stderr
    assert f"{raised.partition('(')[0]}: " in line
    assert "spring.py, line " in line
    assert not (tmp_path / "spring.toml").exists()


def test_a_function_that_answers_batches_otherwise_is_refused(tmp_path: Path):
    with pytest.raises(NeuroAnimatorError, match="BATCHED"):
        system_from(
            tmp_path, SPRING.replace("control[0] -", "control[0] + state[0].mean() -"), "mixed"
        )


def test_a_strangers_dataset_and_emulator_never_run_code(
    folder: Path, cli: Cli, cli_process: Cli, tmp_path: Path
):
    """What is one's own is made in processes that end: this one has never been told to run it."""
    marker = tmp_path / "ran"
    (tmp_path / "spring.py").write_text(f"open({str(marker)!r}, 'w').close()\n" + SPRING)
    for arguments in (
        ("new", "spring.py"),
        ("generate", "spring.toml", "--count", "1200", "--out", "data"),
    ):
        result = cli_process(*arguments, cwd=tmp_path)
        assert result.returncode == 0, result.stderr
    assert marker.exists()
    marker.unlink()
    emulator = "spring.emulator.safetensors"
    result = cli(
        "train",
        "data",
        *small_training(250, "8", 64),
        "--out",
        emulator,
        cwd=tmp_path,
    )
    assert result.returncode == 0, result.stderr
    assert cli("animate", emulator, "--out", "clip.csv", cwd=tmp_path).returncode == 0
    refused = cli("evaluate", emulator, "--data", "data", cwd=tmp_path)
    assert refused.returncode == 3
    assert "run only if you say so: give the TOML file beside it, --system PATH" in refused.stderr
    assert cli("animate", emulator, "--out", "clip.glb", cwd=tmp_path).returncode == 0
    assert not marker.exists()


def test_a_definition_names_code_and_does_not_hold_it(folder: Path):
    definition = json.loads(resolve(str(folder / "spring.toml"))[1])
    digest = hashlib.sha256((folder / "spring.py").read_bytes()).hexdigest()
    assert definition["files"] == {"name": "spring.py", "sha256": digest}
    assert "def step" not in json.dumps(definition)


def test_a_file_that_was_not_given_is_not_run_even_where_it_lies(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    source = SPRING + f"\nopen({str(tmp_path / 'ran')!r}, 'w').close()\n"
    (tmp_path / "spring.py").write_text(source)
    monkeypatch.chdir(tmp_path)
    values = json.loads(resolve(str(folder / "spring.toml"))[1])
    values["files"]["sha256"] = hashlib.sha256(source.encode()).hexdigest()
    system = load_system("spring", canonical_json(values))
    with pytest.raises(NeuroAnimatorError, match="--system PATH"):
        system.simulate(np.zeros((1, 2)), np.zeros((1, 1, 1)), 0.1)
    assert not (tmp_path / "ran").exists()


@pytest.mark.parametrize("batched", [True, False])
def test_arguments_of_a_step_function_are_parameters(batched: bool, tmp_path: Path) -> None:
    source = SPRING.replace(
        "def step(state, control, dt)", "def step(state, control, dt, stiffness)"
    )
    source = source.replace("9.0 * state[0]", "stiffness * state[0]")
    source += 'PARAMETERS = {"stiffness": ("N/m", 5.0, 15.0)}\n'
    family = system_from(tmp_path, source.replace("BATCHED = True", f"BATCHED = {batched}"))
    single = system_from(tmp_path, SPRING, "single")
    stiffness = family.parameters[0]
    assert (stiffness.name, stiffness.unit, stiffness.nominal) == ("stiffness", "N/m", 10.0)
    start = np.array([[0.3, -0.1, 9.0], [0.3, -0.1, 14.0]])
    controls = np.ones((2, 5, 1))
    runs = family.simulate(start, controls, 0.1).states
    alone = single.simulate(start[:1, :2], controls[:1], 0.1).states
    np.testing.assert_allclose(runs[0, :, :2], alone[0], rtol=1e-12)
    assert np.abs(runs[1, -1, :2] - runs[0, -1, :2]).max() > 0.01
    assert (runs[..., 2] == start[:, 2:]).all()
    drawn = family.at(stiffness=7.0).sample_starts(np.random.default_rng(0), 9)
    assert (drawn[:, 2] == 7.0).all()
