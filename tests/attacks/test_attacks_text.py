"""A name in a stranger's file is data, and nothing else to a compiler, a browser, a spreadsheet or a terminal."""

from __future__ import annotations

import io
import sys
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import equinox as eqx
import numpy as np
import pytest
from forgery import HOSTILE_TEXTS, NO_TEXTS, forged_emulator, forged_policy

from neuroanimator import (
    Emulator,
    NeuroAnimatorError,
    load_emulator,
    read_clip,
    write_clip,
    write_report,
)
from neuroanimator.animation.clip import Clip
from neuroanimator.control.policies.policy import Policy
from neuroanimator.definitions.model import Definition
from neuroanimator.emulator.c_emulator import c_program
from neuroanimator.emulator.description import describe
from neuroanimator.errors import BadFileError
from neuroanimator.export.csv_file import read_table, write_table
from neuroanimator.files.atomic import canonical_json, read_tensors
from neuroanimator.files.names import MAX_MODEL_NAME
from neuroanimator.files.tables import check_table, read_toml
from neuroanimator.files.zoo import SHIPPED, shipped_path
from neuroanimator.learn.evaluation.component_errors import ComponentError, error_spread
from neuroanimator.learn.evaluation.evaluate import Evaluation
from neuroanimator.learn.evaluation.weakness.causes import Extrapolation
from neuroanimator.learn.evaluation.weakness.conditions import WeakSpot
from neuroanimator.learn.evaluation.weakness.coverage import Coverage, Divergence, Spread
from neuroanimator.learn.evaluation.weakness.inspection import Inspection
from neuroanimator.learn.evaluation.weakness.readings import Reading
from neuroanimator.learn.evaluation.weakness.worst_segments import Curve, WorstSegment
from neuroanimator.physics.rigid.compiled_model import compile_model
from neuroanimator.physics.rigid.model_system import ModelSystem
from neuroanimator.scaffold.proposal import Proposal, as_toml
from neuroanimator.state.layout import Layout, Slice
from neuroanimator.systems.model_files import ModelFiles
from neuroanimator.terminal import print_rows, print_table, progress_bar

FIELDS = {
    "system": lambda metadata, text: metadata.update(system=text),
    "state": lambda metadata, text: metadata["state"][0].__setitem__(0, text),
    "state's unit": lambda metadata, text: metadata["state"][0].__setitem__(2, text),
    "control": lambda metadata, text: metadata["control"][0].__setitem__(0, text),
    "control's unit": lambda metadata, text: metadata["control"][0].__setitem__(2, text),
    "bone": lambda metadata, text: metadata["skeleton"][0].update(name=text),
    "definition": lambda metadata, text: metadata.update(definition=text),
    "network": lambda metadata, text: metadata["network"].update(kind=text),
}


def _put(field: str, text: Any, metadata: dict[str, Any]) -> None:
    FIELDS[field](metadata, text)


def refusal(path: Path, load: Any = Emulator.load) -> str:
    with pytest.raises(BadFileError) as caught:
        load(path)
    message = str(caught.value)
    assert message.isprintable()
    assert len(message) < 1000
    return message


@pytest.mark.parametrize("field", FIELDS)
def test_hostile_text_in_an_emulator_is_refused(field: str, tmp_path: Path):
    for title, text in {**HOSTILE_TEXTS, **NO_TEXTS}.items():
        if (field, title) in {("definition", "nothing"), ("state", "right to left letters")}:
            continue
        try:
            path = forged_emulator(
                tmp_path / "e.safetensors",
                lambda metadata, text=text: FIELDS[field](metadata, text),
            )
        except (NeuroAnimatorError, UnicodeEncodeError, ValueError):
            continue  # not even an attacker can write it
        assert refusal(path), title


@pytest.mark.parametrize("field", ["system", "state", "bone"])
def test_hostile_text_in_a_policy_is_refused(field: str, tmp_path: Path):
    changes = FIELDS | {
        "bone": lambda metadata, text: metadata["skeleton"]["bones"][0].update(name=text)
    }
    for title in ("script", "formula", "escape code", "right to left", "C out of a comment"):
        text = HOSTILE_TEXTS[title]
        path = forged_policy(
            tmp_path / "p.safetensors",
            lambda metadata, text=text: changes[field](metadata["emulator"], text),
        )
        assert refusal(path, Policy.load), title


def test_a_policys_contract_is_its_own_and_nobody_elses(tmp_path: Path):
    for change in (
        lambda metadata: metadata["command"][0].__setitem__(0, "<script>"),
        lambda metadata: metadata.update(command=None),
        lambda metadata: metadata.update(ranges=[[0, 0, 0, 0], [1e300, 1, 1, 1]]),
        lambda metadata: metadata.update(ranges=[[0, 0, 0, 0], [0, 1, 1, 1]]),
        lambda metadata: metadata.update(widths=[2.5]),
        lambda metadata: metadata.update(widths=[]),
        lambda metadata: metadata.update(emulator_sha256="0" * 64),
        lambda metadata: metadata.update(emulator=[]),
    ):
        refusal(forged_policy(tmp_path / "p.safetensors", change), Policy.load)


def test_two_parts_of_one_name_are_refused(tmp_path: Path):
    path = forged_emulator(
        tmp_path / "e.safetensors", lambda metadata: metadata["state"][1].__setitem__(0, "angle")
    )
    assert "two parts are called 'angle'" in refusal(path)


def renamed(emulator: Emulator, text: str) -> Emulator:
    """Return the emulator with `text` in every place that holds text."""
    spec = emulator.spec
    layouts = [
        Layout(tuple(Slice(f"{text}{i}", part.size, text) for i, part in enumerate(layout.slices)))
        for layout in (spec.state, spec.control)
    ]
    bones = tuple(replace(bone, name=text) for bone in spec.skeleton.bones)
    named = replace(
        spec,
        system=text,
        state=layouts[0],
        control=layouts[1],
        definition=text,
        skeleton=replace(spec.skeleton, bones=bones),
    )
    return eqx.tree_at(lambda each: each.spec, emulator, named)


def test_no_text_of_an_emulator_reaches_generated_c(shipped: Emulator):
    text = HOSTILE_TEXTS["C out of a comment"]
    assert c_program(renamed(shipped, text)).text == c_program(shipped).text
    assert "constructor" not in c_program(renamed(shipped, text)).text
    assert shipped.system not in c_program(shipped).text


def an_inspection(text: str) -> Inspection:
    """An inspection with `text` wherever there is any."""
    numbers = np.linspace(0.1, 1, 5)
    spread = Spread.of(Reading(text, text, numbers), (0.0, 1.0))
    divergence = Divergence(2, 0.5, (text,))
    covered = Coverage(text, 5, 5, 1, (spread,), (spread,), divergence, (text,))
    motion = numbers[:, None]
    curve = Curve(text, text, numbers, numbers + 0.1)
    segment = WorstSegment(0, 0.0, 0.05, 0.1, text, (curve,), motion, motion, motion)
    return Inspection(
        system=text,
        substeps=50,
        dt=0.05,
        runs=1,
        samples=5,
        errors=error_spread(numbers),
        components=(ComponentError(text, text, 0.1, 0.2, 0.3, 0.4),),
        weak_spots=(WeakSpot(text, 3.0, 0.1, 0.05, 0.2, text),),
        outside=Extrapolation(1, 0.2, 3.0),
        trust=(),
        worst=(segment,),
        coverage=covered,
        has_data=True,
        causes=(text,),
    )


def an_evaluation(text: str) -> Evaluation:
    numbers = np.linspace(0.1, 1, 5)
    return Evaluation(
        system=text,
        substeps=50,
        dt=0.05,
        entries=[f"{text}[0] {text}"],
        error_by_entry=numbers[:1],
        times=np.arange(5) * 0.05,
        rollout_errors=numbers,
        self_divergence=None,
        sample_emulated=numbers[:, None],
        sample_physics=numbers[:, None],
        measured_speed=None,
        emulator_seconds=1e-6,
        baselines={text: 0.5},
        diverged=0,
        diverged_starts=10,
        inspection=an_inspection(text),
    )


@pytest.mark.parametrize(
    "title", ["script", "image with a handler", "dollar", "C out of a comment"]
)
def test_a_report_holds_no_markup_but_its_own(title: str, tmp_path: Path):
    text = HOSTILE_TEXTS[title]
    write_report([an_evaluation(text)], tmp_path / "report.html")
    page = Elements((tmp_path / "report.html").read_text(encoding="utf-8"))
    assert "svg" in page.tags
    assert not page.tags & {"script", "img"}
    assert not [name for name in page.attributes if name.startswith("on")]


class Elements(HTMLParser):
    """What a browser would find in a page."""

    def __init__(self, page: str):
        super().__init__()
        self.tags: set[str] = set()
        self.attributes: set[str] = set()
        self.feed(page)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.add(tag)
        self.attributes.update(name for name, _ in attrs)


NEVER_IN_A_TABLE = ("half a surrogate pair", "long")
"""Texts no file can hold, or no line of a table: names have at most 80 letters."""


@pytest.mark.parametrize(
    "title", [title for title in HOSTILE_TEXTS if title not in NEVER_IN_A_TABLE]
)
def test_a_table_can_be_read_back_and_no_head_is_a_formula(title: str, tmp_path: Path):
    layout = Layout((Slice(HOSTILE_TEXTS[title], 2, "m"), Slice("plain", 1, "1")))
    path, rows = tmp_path / "table.csv", np.array([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]])
    write_table(path, np.array([0.0, 0.1]), rows, layout)
    times, found = read_table(path, layout)
    np.testing.assert_allclose(found, rows)
    np.testing.assert_allclose(times, [0.0, 0.1])
    content = path.read_text(encoding="utf-8")
    assert content.splitlines() == content.split("\n")[:-1]
    for cell in content.split("\n")[0].split(","):
        assert not cell.lstrip('"').startswith(("=", "+", "-", "@", "\t"))


def test_what_animate_writes_read_clip_reads_for_every_name_that_loads(
    shipped: Emulator, tmp_path: Path
):
    path = forged_emulator(
        tmp_path / "e.safetensors",
        lambda metadata: metadata["state"][0].__setitem__(0, "left hip/x:2.Größe-1"),
    )
    emulator = Emulator.load(path)
    states = np.zeros((3, emulator.state.size))
    clip = Clip(emulator.system, emulator.skeleton, np.arange(3) / 30, states)
    write_clip(clip, tmp_path / "clip.csv", emulator.state)
    np.testing.assert_allclose(read_clip(tmp_path / "clip.csv", emulator).states, states)


def test_nothing_printed_steers_the_terminal(capsys: pytest.CaptureFixture[str]):
    for text in HOSTILE_TEXTS.values():
        print_rows([(text, text), ("plain", 1)])
        print_table([{text: text}, {text: 1.5}])
    shown = capsys.readouterr().out
    assert all(letter.isprintable() for letter in shown.replace("\n", ""))
    print_rows([("unit", "N·m, m/s², µs, Δt")])
    assert "N·m, m/s², µs, Δt" in capsys.readouterr().out


def test_a_bar_shows_markup_as_it_is(monkeypatch: pytest.MonkeyPatch):
    class Terminal(io.StringIO):
        def isatty(self) -> bool:
            return True

    screen = Terminal()
    monkeypatch.setattr(sys, "stderr", screen)
    with progress_bar("[red]arm[/red] [/nothing]", 2) as bar:
        bar.advance_to(1, "[bold]\x1b]0;owned\x07")
    shown = screen.getvalue()
    assert "[red]arm[/red]" in shown
    assert "\x1b]0;" not in shown


MODEL = """<mujoco><worldbody><body name="{body}"><joint name="{joint}" type="hinge"/><geom size="0.1"/></body>
</worldbody><actuator><motor name="{motor}" joint="{joint}" ctrlrange="-1 1"/></actuator>
<sensor><jointvel name="{sensor}" joint="{joint}"/></sensor></mujoco>"""


def test_what_a_model_calls_its_parts_is_made_harmless():
    """MJCF allows any text as a name, and a model is no less a stranger's than an emulator."""
    names = {
        "body": "&lt;script&gt;",
        "joint": "=1+1,&quot;x&quot;",
        "motor": "*/ go /*",
        "sensor": "[red]&#x202e;",
    }
    text = MODEL.format(**names)
    model = compile_model(ModelFiles("m.xml", (("m.xml", text.encode()),)))
    step = {"step": 0.002, "truth_step": 0.002, "fine_step": 0.0002}
    values = {"name": "m", "model": "m.xml", "physics": step, "sensors": ["_red__"]}
    system = ModelSystem(check_table(values, "m", Definition), model)
    assert Layout.from_json(system.state.to_json(), "state") == system.state
    assert Layout.from_json(system.control.to_json(), "control") == system.control
    assert [bone.name for bone in system.skeleton.bones] == ["_script_"]
    assert system.control.slices[0].name == "_/ go /_"


def test_every_shipped_emulator_says_the_same_after_the_checks():
    """The checks change no number: what is read is what was written."""
    for name, substeps in SHIPPED:
        path = shipped_path(name, substeps)
        metadata = read_tensors(path, "emulator")[1]
        described = describe(Emulator.load(path))
        assert canonical_json(described) == canonical_json(
            {key: metadata[key] for key in described}
        )


def test_shipped_names_keep_the_rules():
    assert load_emulator("fish-50").state.names[0] == "nose[0] m"


@pytest.mark.parametrize("title", sorted(set(HOSTILE_TEXTS) - {"half a surrogate pair"}))
def test_a_proposal_with_hostile_names_is_a_toml_file_that_says_the_same(
    title: str, tmp_path: Path
):
    # As long as a model's names are kept.
    text = HOSTILE_TEXTS[title][:MAX_MODEL_NAME]
    values = {
        "name": "mine",
        "model": "mine.xml",
        "keyframe": text,
        "physics": {"step": 1e-8, "truth_step": 0.1 / 3, "fine_step": 2e-5},
        "state": {text: "sine"},
        "control": {text: [-1e22, 0.1 + 0.2]},
        "sensors": [text],
        "sampling": {"position": {text: [-1 / 3, 5e-324]}},
    }
    definition = check_table(values, "mine.toml", Definition)
    comments = dict.fromkeys((*values, f"control.{text}", "physics.step"), text)
    path = tmp_path / "mine.toml"
    path.write_text(as_toml(Proposal(definition, comments, parts=(text,))), encoding="utf-8")
    assert check_table(read_toml(path), "mine.toml", Definition) == definition
