"""Suites that the ordinary run does not load (``python -m tests lerobot``, ``peers``, ``newton``) import only
names that exist. Without this test a moved name would fail only when such a suite runs."""

from __future__ import annotations

import ast
import importlib
from pathlib import Path

import pytest

from .test_imports import PACKAGE, ROOT, imports_of, is_in, modules_below

SUITES = ("tests.lerobot", "tests.peers", "tests.newton", "tests.view.rerun_suite")
MODULES = modules_below(ROOT, "tests") | modules_below(ROOT, PACKAGE)


def names_of(path: Path) -> set[str]:
    """Return the names that a module defines, imports or assigns."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text())):
        match node:
            case ast.FunctionDef(name=name) | ast.AsyncFunctionDef(name=name) | ast.ClassDef(name=name):
                names.add(name)
            case ast.Import(names=imported) | ast.ImportFrom(names=imported):
                names.update(alias.asname or alias.name for alias in imported)
            case ast.Name(id=name, ctx=ast.Store()):
                names.add(name)
    return names


def is_there(target: str) -> bool:
    """Return True if ``target`` exists. It is a module, or a module and a name in it."""
    if target in MODULES:
        return True
    module, _, name = target.rpartition(".")
    if is_in(module, *SUITES):  # importing it may need a package that is not installed
        return module in MODULES and name in names_of(MODULES[module])
    return hasattr(importlib.import_module(module), name)


def missing(module: str, source: str) -> list[str]:
    """Return the names that a module imports from the tests or the package and that do not exist."""
    is_package = module in MODULES and MODULES[module].name == "__init__.py"
    targets = [each.target for each in imports_of(module, is_package, source)]
    return [target for target in targets if is_in(target, "tests", PACKAGE) and not is_there(target)]


@pytest.mark.parametrize("module", sorted(name for name in MODULES if is_in(name, *SUITES)))
def test_the_imports_of_a_separate_suite_exist(module: str) -> None:
    assert missing(module, MODULES[module].read_text()) == []


def test_a_name_that_moved_is_found() -> None:
    source = "from tests.drivers.plain.rig import SmallArm, pid_of\nfrom .calibration import NAME, write, gone"
    assert missing("tests.lerobot.test_driver", source) == [
        "tests.drivers.plain.rig.pid_of",
        "tests.lerobot.calibration.gone",
    ]
