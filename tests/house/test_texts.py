"""The text of a message is for people only. No program makes a decision by parsing it."""

from __future__ import annotations

import ast
from collections.abc import Iterator

import pytest

from .test_imports import MODULES, PACKAGE

TEXTS = {"text", "reason", "cause", "remedy", "detail", "exit_detail", "note"}
"""Attributes that hold sentences."""
TAKES_APART = {
    "startswith",
    "endswith",
    "removeprefix",
    "removesuffix",
    "partition",
    "rpartition",
    "split",
    "rsplit",
    "find",
    "index",
    "count",
    "replace",
}
MATCHES = {"match", "search", "fullmatch", "findall", "finditer"}
WIRES = f"{PACKAGE}.drivers."
"""Modules that may parse texts of their robots, but not the texts of our refusals."""
ALLOWED = {
    "contract.options": "where msgspec found what is wrong stands only in its text",
    "kernel.processes.reserve": "Python has one error for all that a thread may lack",
}


def read_back(source: str, of_robots: bool = False) -> Iterator[tuple[int, str]]:
    """Yield line and expression of each place that parses the text of a message. With ``of_robots``, only texts
    that are called a refusal count as messages."""
    tree = ast.parse(source)
    caught = {node.name for node in ast.walk(tree) if isinstance(node, ast.ExceptHandler) and node.name}

    def is_text(node: ast.expr) -> bool:
        if isinstance(node, ast.Attribute):
            ours = not of_robots or "refus" in ast.unparse(node.value)
            return ours and node.attr in TEXTS
        if of_robots:
            return False
        is_str = isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "str"
        return is_str and len(node.args) == 1 and isinstance(node.args[0], ast.Name) and node.args[0].id in caught

    for node in ast.walk(tree):
        found = False
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
            takes = node.func.attr in TAKES_APART and bool(node.args) and is_text(node.func.value)
            found = takes or (node.func.attr in MATCHES and any(map(is_text, node.args)))
        elif isinstance(node, ast.Compare):
            contains = any(isinstance(op, ast.In | ast.NotIn) for op in node.ops)
            sides = [node.left, *node.comparators]
            equals = any(
                isinstance(side, ast.Constant) and isinstance(side.value, str) and side.value for side in sides
            )
            words = [side for side in node.comparators if is_text(side)] if contains else []
            found = bool(words) or (equals and any(map(is_text, sides)))
        if found:
            yield node.lineno, ast.unparse(node)


CASES = [
    ('refusal.reason.removeprefix("move: ")', True),
    ('"expired" in status.cause', True),
    ('status.cause == "the setpoint expired"', True),
    ('re.search("process", answer.text)', True),
    ('try:\n    pass\nexcept OSError as error:\n    str(error).startswith("no")', True),
    ("refusal.code in LATE", False),
    ('f"{refusal.text}"', False),
    ("status.cause or other", False),
]


@pytest.mark.parametrize(("source", "found"), CASES)
def test_code_that_parses_a_message_is_found(source: str, found: bool) -> None:
    assert bool(list(read_back(source))) is found


def test_in_a_wire_only_texts_of_refusals_count() -> None:
    assert list(read_back("refusal.text.removeprefix('move: ')", of_robots=True))
    assert not list(read_back("event.text.startswith('ready')", of_robots=True))


def test_no_program_parses_a_text_for_people() -> None:
    found = {
        name: places
        for name, path in sorted(MODULES.items())
        if not name.startswith(f"{PACKAGE}.testing.") and name.removeprefix(f"{PACKAGE}.") not in ALLOWED
        if (places := list(read_back(path.read_text(), name.startswith(WIRES))))
    }
    assert not found, "decide by a code, not by the text of a message"
