"""Names in the code are nouns and verbs of the field. Words that say nothing about a value are not used."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

from .test_imports import ROOT

FOLDERS = ("strands_actors", "drivers", "supervisors")

EMPTY_WORDS = {"told", "said", "heard", "owed", "asked", "whom", "whose", "wanted", "untold"}
"""A name with one of these parts describes an event, and not the value."""

EMPTY_NAMES = {"at", "what", "who", "found", "known", "gone", "meant", "come"}
"""These words have no meaning as whole names. They may be a part of a name: ``sent_at_ns``, ``is_known``."""

PUBLIC = {("strands_actors/caller/handle/factory.py", "at"), ("strands_actors/caller/resolve/wanted.py", "at")}
"""Keywords that users type: ``Robot(..., at=HOST)``."""


def names_of(tree: ast.AST) -> Iterator[tuple[str, int]]:
    """Yield each name that the code defines, with its line."""
    for node in ast.walk(tree):
        match node:
            case ast.Name(id=name, ctx=ast.Store()) | ast.Attribute(attr=name, ctx=ast.Store()) | ast.arg(arg=name):
                yield name, node.lineno
            case ast.FunctionDef(name=name) | ast.AsyncFunctionDef(name=name) | ast.ClassDef(name=name):
                yield name, node.lineno


def words_of(name: str) -> list[str]:
    """Split ``last_told_ns`` and ``ToldBy`` into words."""
    return [word.lower() for word in re.findall(r"[A-Z]?[a-z]+|[A-Z]+", name)]


def empty_names(source: str) -> list[tuple[str, int]]:
    return [
        (name, line)
        for name, line in names_of(ast.parse(source))
        if name.strip("_") in EMPTY_NAMES or EMPTY_WORDS.intersection(words_of(name))
    ]


def files() -> list[Path]:
    return [file for folder in FOLDERS for file in sorted((ROOT / folder).rglob("*.py"))]


def test_names_say_what_the_value_is() -> None:
    empty = [
        f"{path}:{line}: {name}"
        for file in files()
        for path in [str(file.relative_to(ROOT))]
        for name, line in empty_names(file.read_text())
        if (path, name) not in PUBLIC
    ]
    assert not empty, "rename to a noun for a value, or a verb for a function"


def test_an_empty_name_is_found() -> None:
    source = "class Heard:\n    def f(self, at: int) -> None:\n        self.told_ns = known_at = at\n"
    assert empty_names(source) == [("Heard", 1), ("at", 2), ("told_ns", 3)]
