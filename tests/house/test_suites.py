"""Suites that the ordinary run does not load (``python -m tests lerobot``, ``peers``, ``newton``) import only
what is there: a name that moves would be found by whoever runs them next."""

from __future__ import annotations

import ast
import importlib
from pathlib import Path

import pytest

from .test_imports import PACKAGE, ROOT, imports_of, is_in, modules_below

SUITES = ("tests.lerobot", "tests.peers", "tests.newton")
MODULES = modules_below(ROOT, "tests") | modules_below(ROOT, PACKAGE)


def names_of(path: Path) -> set[str]:
    """Return what a module's own lines define, import or assign."""
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
    """``target``: a module, or a module and a name in it."""
    if target in MODULES:
        return True
    module, _, name = target.rpartition(".")
    if is_in(module, *SUITES):  # it may need what is not installed here
        return module in MODULES and name in names_of(MODULES[module])
    return hasattr(importlib.import_module(module), name)


def missing(module: str, source: str) -> list[str]:
    """Return what a module takes from tests and package, and is not there."""
    is_package = module in MODULES and MODULES[module].name == "__init__.py"
    targets = [each.target for each in imports_of(module, is_package, source)]
    return [target for target in targets if is_in(target, "tests", PACKAGE) and not is_there(target)]


@pytest.mark.parametrize("module", sorted(name for name in MODULES if is_in(name, *SUITES)))
def test_what_a_suite_apart_imports_is_there(module: str) -> None:
    assert missing(module, MODULES[module].read_text()) == []


def test_a_name_that_moved_is_found() -> None:
    source = "from tests.drivers.plain.rig import SmallArm, pid_of\nfrom .calibration import NAME, write, gone"
    assert missing("tests.lerobot.test_driver", source) == [
        "tests.drivers.plain.rig.pid_of",
        "tests.lerobot.calibration.gone",
    ]
