"""What the package says to people changes only where somebody has looked at it."""

from __future__ import annotations

from difflib import unified_diff

import pytest
from messages import LIST, all_messages, messages


def test_every_message_is_the_one_in_the_list():
    listed = LIST.read_text(encoding="utf-8").splitlines()
    difference = "\n".join(
        unified_diff(
            listed, all_messages(), "tests/messages.txt", "src/neuroanimator", n=0, lineterm=""
        )
    )
    assert not difference, (
        f"the messages are others than those listed:\n{difference}\n"
        "If that is meant: .venv/bin/python tests/messages.py"
    )


@pytest.mark.parametrize(
    ("source", "expected"),
    [
        ("raise BadFileError(f'{path}: damaged. ' + f'Make it again.')", {"{}: damaged. Make it again."}),
        ("raise ValueError('sizes')", {"sizes"}),
        (
            "raise ArgumentError(f\"left: {'none at all' if left else 'some'}\")",
            {"left: {}", "none at all", "some"},
        ),
        ("hint = 'Make it again.'\nkey = 'made'", {"Make it again."}),
        ("def f() -> 'Float of some size':\n    'A docstring of four words.'", set()),
        ("file.write('static const float of[3];')", set()),
    ],
)  # fmt: skip
def test_what_is_a_message(source: str, expected: set[str]):
    assert messages(source) == expected
