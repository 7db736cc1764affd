"""TOML of strangers: refused in one line, within a second and 100 MB, whatever it is."""

from __future__ import annotations

from pathlib import Path

import pytest
from fuzz.measure import Refusal, check_refusal, refusals
from fuzz.seeds import JELLY, STEP

from neuroanimator.errors import BadFileError
from neuroanimator.files.tables import read_toml

ATTACKS = {
    "deep lists": ("a=" + "[" * 100_000, "deep"),
    "deep tables": ("a=" + "{a=" * 50_000, "deep"),
    "a key of dots": ("a." * 20_000 + "a=1", "dots in one key"),
    "a quoted key of dots": ('"a".' * 20_000 + "a=1", "dots in one key"),
    "a header of dots": ("[" + "a." * 20_000 + "a]", "dots in one key"),
    "a long whole number": ("a=" + "1" * 5_000, "5,000 characters"),
    "a long hexadecimal number": ("a=0x" + "f" * 5_000, "5,002 characters"),
    "a long number as a size": (
        STEP.replace('unit = "rad"', 'unit = "rad"\nsize = 1' + "0" * 60),
        "state.0.size",
    ),
    "many values": ("a=[" + "1," * 200_000 + "]", "more than 50,000 values"),
    "many keys": ("".join(f"a{i}=1\n" for i in range(40_000)) + "=", "line"),
    "many tables": ("".join(f"[a{i}]\n" for i in range(40_000)), "name: field required"),
    "a quote without end, again and again": ("a=" + '\\"""\n' * 80_000, "not a readable TOML"),
    "a string without end": ("a='''" + "''\n" * 100_000, "not a readable TOML"),
    "escapes without end": ('a="' + '\\"' * 200_000, "not a readable TOML"),
    "too large": ("#" * 600_000, "bytes; wanted at most 524,288"),
    "another alphabet": ("a = '\x00'", "not a readable TOML"),
    "a date that is none": ("a = 2020-99-99", "not a readable TOML"),
    "a step of almost nothing": (
        JELLY.replace("fine_step = 0.0001", "fine_step = 1e-300"),
        "physics.fine_step",
    ),
    "a step that is no number": (
        JELLY.replace("fine_step = 0.0001", "fine_step = nan"),
        "physics.fine_step",
    ),
    "a sampling interval of almost nothing": (STEP.replace("0.02", "1e-300"), "physics.step"),
    "40,000 wrong names": (JELLY + "[groups]\nall = [" + '"?",' * 40_000 + "]\n", "groups.all"),
    "40,000 members that are not there": (
        JELLY + "[groups]\nall = [" + '"z",' * 40_000 + "]\n",
        "no node called 'z'",
    ),
    "10,000 pairs in a muscle": (
        JELLY + "pull2 = [" + '["a","b"],' * 10_000 + '["a","z"]]\n',
        "no node called 'z'",
    ),
}


@pytest.fixture(scope="module")
def answers(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Refusal]:
    inputs = {name: ("toml", text.encode()) for name, (text, _) in ATTACKS.items()}
    return refusals(inputs, tmp_path_factory.mktemp("toml"))


@pytest.mark.parametrize("name", ATTACKS)
def test_a_definition_is_refused_in_a_second_and_100_megabytes(
    answers: dict[str, Refusal], name: str
):
    check_refusal(answers[name], ATTACKS[name][1])


def test_the_line_at_fault_is_named(tmp_path: Path):
    path = tmp_path / "a.toml"
    path.write_text("a = 1\nb = 2\nc = " + "[" * 20)
    with pytest.raises(
        BadFileError, match=r"a.toml is not a readable TOML file: line 3: more than 16 lists"
    ):
        read_toml(path)


def test_brackets_dots_and_digits_within_texts_and_comments_count_for_nothing(tmp_path: Path):
    path = tmp_path / "a.toml"
    inside = "[" * 50 + "." * 50 + "1" * 100
    path.write_text(
        f"a = \"{inside}\"\nb = '{inside}'\n# {inside}\nc = \"\"\"\n{inside}\"\n\"\"\"\nd = '''\n{inside}'''''\n"
    )
    assert read_toml(path) == {"a": inside, "b": inside, "c": inside + '"\n', "d": inside + "''"}


def test_a_file_saved_with_a_byte_order_mark_is_read(tmp_path: Path):
    path = tmp_path / "a.toml"
    path.write_bytes(b"\xef\xbb\xbf" + 'unit = "N·m"'.encode())
    assert read_toml(path) == {"unit": "N·m"}


@pytest.mark.parametrize("name", ["/dev/zero", "."])
def test_what_is_no_file_is_refused_instead_of_read_for_ever(name: str):
    with pytest.raises(BadFileError, match="is not a file"):
        read_toml(Path(name))
