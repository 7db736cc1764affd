"""The list of everything the package says to people: errors, warnings, help, reports.

`messages.txt` is that list, as it was when somebody last looked at it. What changes there is seen in review:

    python tests/messages.py     write the list anew
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

LIST = Path(__file__).with_name("messages.txt")
ROOT = Path(__file__).parents[1]
PACKAGES = (ROOT / "src" / "neuroanimator", ROOT / "studio" / "neuroanimator_studio")

COMPLAINING = re.compile(r"(Error|_error|warn|warn_once)$")
"""The ends of the names of what is called with a message; there a single word is one."""

MIN_WORDS = 3
"""Elsewhere a text of fewer words is a key or a label."""

CODE = re.compile(
    r"[;{}]\n|; ?}|#define|#include|</|/>|<[a-z]+ [a-z]+=|\(int |static |^float |^const "
)
"""What is found in texts that are C, HTML or MuJoCo's XML, not English."""


def messages(source: str) -> set[str]:
    """Return every message in the text of a module; what is filled in when it runs is shown as {}."""
    tree = ast.parse(source)
    return set(_messages_under(tree, _unread(tree), is_complaint=False))


def all_messages() -> list[str]:
    """Return the lines of the list as the packages are now, sorted."""
    every: set[str] = set()
    for package in PACKAGES:
        for file in package.rglob("*.py"):
            every |= messages(file.read_text(encoding="utf-8"))
        for file in package.rglob("templates/*"):
            every |= template_messages(file.read_text(encoding="utf-8"))
    return sorted(message.replace("\n", "\\n") for message in every)


def template_messages(source: str) -> set[str]:
    """Return every text in a template between tags of its markup; what is filled in is shown as {}."""
    filled = re.sub(r"{{.*?}}", "{}", re.sub(r"{#.*?#}", "", source))
    texts = re.split(r"{%.*?%}|<[^>]*>|\n\n", filled)
    return {" ".join(text.split()) for text in texts if _is_message(text, is_complaint=False)}


def _unread(tree: ast.Module) -> set[ast.AST]:
    """Return what a user never reads: docstrings and annotations."""
    unread: set[ast.AST] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            unread.add(node.value)
        elif isinstance(node, ast.FunctionDef) and node.returns is not None:
            unread.add(node.returns)
        elif isinstance(node, ast.arg | ast.AnnAssign) and node.annotation is not None:
            unread.add(node.annotation)
    return unread


def _messages_under(node: ast.AST, unread: set[ast.AST], is_complaint: bool) -> Iterator[str]:
    """Yield the messages in `node`, each f-string and each sum of texts as a whole, then those filled into it."""
    if node in unread:
        return
    is_call = isinstance(node, ast.Call)
    if isinstance(node, ast.Raise) or (is_call and COMPLAINING.search(ast.unparse(node.func))):
        is_complaint = True
    text = _text(node)
    if text is not None and _is_message(text, is_complaint):
        yield text
    for part in _filled_in(node) if text is not None else ast.iter_child_nodes(node):
        yield from _messages_under(part, unread, is_complaint)


def _text(node: ast.AST) -> str | None:
    """Return the text `node` is, with {} for what is filled in; None if it is no text."""
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        return node.value
    if isinstance(node, ast.JoinedStr):
        return "".join(_text(part) or "{}" for part in node.values)
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add):
        sides = [_text(node.left), _text(node.right)]
        if any(side is not None for side in sides):
            return "".join("{}" if side is None else side for side in sides)
    return None


def _filled_in(text: ast.AST) -> Iterator[ast.AST]:
    """Yield what is filled into a text: the expressions of an f-string, the sides of a sum that are no texts."""
    if isinstance(text, ast.FormattedValue):
        yield text.value
    elif isinstance(text, ast.JoinedStr):
        for part in text.values:
            yield from _filled_in(part)
    elif isinstance(text, ast.BinOp):
        for side in (text.left, text.right):
            if _text(side) is None:
                yield side
            else:
                yield from _filled_in(side)


def _is_message(text: str, is_complaint: bool) -> bool:
    words = re.findall("[A-Za-z]{2,}", text)
    if CODE.search(text):
        return False
    is_sentence = len(words) >= MIN_WORDS and " " in text.strip()
    return is_sentence or (is_complaint and bool(words))


if __name__ == "__main__":
    LIST.write_text("\n".join(all_messages()) + "\n", encoding="utf-8")
