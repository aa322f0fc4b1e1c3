"""``__all__`` lists every public name. README, docs and examples import only public names."""

from __future__ import annotations

import ast
import importlib
import re
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pytest

from .plain_words import pages
from .test_imports import MODULES, PACKAGE, ROOT

PUBLIC = (
    PACKAGE,  # users
    f"{PACKAGE}.contract",  # authors of drivers
    f"{PACKAGE}.policies",  # authors of policies
    f"{PACKAGE}.testing",
    f"{PACKAGE}.simulation.scenes",  # a scene for evaluations
    f"{PACKAGE}.surfaces.cameras",  # readers of camera pictures
    f"{PACKAGE}.drivers.earthrover.cameras",  # cameras of one robot that are not part of its tree
)

BLOCK = re.compile(r"^```python\n(.*?)^```", re.MULTILINE | re.DOTALL)
INLINE = re.compile(rf"(?:from {PACKAGE}[\w.]* import [\w, ]+|import {PACKAGE}[\w.]*)")


class Used(NamedTuple):
    where: str
    module: str
    name: str  # empty: the module itself


def imports_in(where: str, source: str) -> Iterator[Used]:
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.ImportFrom) and (node.module or "").partition(".")[0] == PACKAGE:
            yield from (Used(where, node.module or "", alias.name) for alias in node.names)
        elif isinstance(node, ast.Import):
            names = (alias.name for alias in node.names)
            yield from (Used(where, name, "") for name in names if name.partition(".")[0] == PACKAGE)


def imports_of_page(where: str, text: str) -> Iterator[Used]:
    for block in BLOCK.findall(text):
        yield from imports_in(where, block)
    for line in INLINE.findall(BLOCK.sub("", text)):
        yield from imports_in(where, line.rstrip(" ,"))


def all_used() -> list[Used]:
    found: list[Used] = []
    for path in pages():
        found += imports_of_page(str(path.relative_to(ROOT)), path.read_text())
    for path in sorted((ROOT / "examples").glob("*.py")):
        found += imports_in(str(path.relative_to(ROOT)), path.read_text())
    return found


def problem(used: Used) -> str:
    """Return the reason why users should not import this name, or an empty text."""
    if used.module not in PUBLIC:
        return f"{used.where}: {used.module} is private"
    module = importlib.import_module(used.module)
    if used.name and used.name not in module.__all__:
        return f"{used.where}: {used.module} has no public {used.name}"
    return ""


def test_the_imports_of_pages_and_examples_are_public_and_exist() -> None:
    used = all_used()
    assert {one.where for one in used} >= {"README.md", "docs/testing.md", "examples/policy.py"}
    assert [reason for one in used if (reason := problem(one))] == []


@pytest.mark.parametrize("name", PUBLIC)
def test_a_public_name_exists_and_stands_once(name: str) -> None:
    module = importlib.import_module(name)
    assert len(set(module.__all__)) == len(module.__all__)
    assert [each for each in module.__all__ if getattr(module, each, None) is None] == []
    assert set(module.__all__) <= set(dir(module))


def test_the_page_lists_every_public_module() -> None:
    page = (ROOT / "docs" / "architecture.md").read_text()
    assert [name for name in PUBLIC if f"`{name}`" not in page] == []


def test_a_driver_can_be_written_on_the_contract_alone() -> None:
    source = (ROOT / "tests" / "fake_kinds.py").read_text()
    assert {used.module for used in imports_in("tests.fake_kinds", source)} == {f"{PACKAGE}.contract"}


# -- the rules themselves


@pytest.mark.parametrize(
    ("page", "message"),
    [
        ("```python\nfrom strands_actors.kernel.node import Node\n```\n", "is private"),
        ("```python\nfrom strands_actors import Robot, Rowboat\n```\n", "no public Rowboat"),
        ("`from strands_actors.contract import Axis, Axes`", "no public Axes"),
        ("```python\nimport strands_actors.caller.session.tree\n```\n", "is private"),
        ("```python\nfrom strands_actors import Robot\n```\n", ""),
        ("`from strands_actors.contract import Driver, Wire`", ""),
    ],
)
def test_a_private_or_missing_name_is_found(page: str, message: str) -> None:
    problems = [why for used in imports_of_page("page", page) if (why := problem(used))]
    assert [message in why for why in problems] == ([True] if message else [])


def test_every_public_module_is_one() -> None:
    assert [name for name in PUBLIC if name not in MODULES] == []
    assert Path(MODULES[PACKAGE]).name == "__init__.py"
