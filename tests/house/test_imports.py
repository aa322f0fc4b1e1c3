"""Dependencies have one direction: surfaces -> supervisors -> contract, kernel <- drivers. The tests read the
imports of the source code."""

from __future__ import annotations

import ast
import functools
import os
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pytest

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = "strands_actors"


class Import(NamedTuple):
    line: int
    target: str  # absolute: a module, or a module and a name in it


def modules_below(root: Path, package: str) -> dict[str, Path]:
    """Return every module of the package by its full name. Symbolic links are followed."""
    found = {}
    for directory, _, files in os.walk(root / package, followlinks=True):
        for file in files:
            if file.endswith(".py"):
                parts = (Path(directory) / file).relative_to(root).with_suffix("").parts
                found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = Path(directory) / file
    return found


def imports_of(name: str, is_package: bool, source: str | ast.Module) -> Iterator[Import]:
    """Return the imports of a module: at load time, later in a function, and for type checkers only."""
    package = name if is_package else name.rpartition(".")[0]
    for node in ast.walk(ast.parse(source) if isinstance(source, str) else source):
        if isinstance(node, ast.Import):
            for alias in node.names:
                yield Import(node.lineno, alias.name)
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                above = package.split(".")[: len(package.split(".")) - node.level + 1]
                base = ".".join([*above, base] if base else above)
            for alias in node.names:
                yield Import(node.lineno, f"{base}.{alias.name}")


MODULES = modules_below(ROOT, PACKAGE)


@functools.cache
def trees() -> dict[str, ast.Module]:
    """Return the syntax tree of every module."""
    return {name: ast.parse(path.read_text()) for name, path in sorted(MODULES.items())}


@functools.cache
def all_imports() -> dict[str, list[Import]]:
    """Return the imports of every module. Only a test calls it, so that collecting the tests stays fast."""
    return {
        name: list(imports_of(name, MODULES[name].name == "__init__.py", tree)) for name, tree in trees().items()
    }


def module_of(target: str) -> str:
    """Return the module that an import loads: a.b.c or a.b for ``from a.b import c``."""
    return target if target in MODULES else target.rpartition(".")[0]


def is_in(module: str, *packages: str) -> bool:
    return any(module == package or module.startswith(f"{package}.") for package in packages)


def allowed(name: str) -> tuple[str, ...] | None:
    """Return the parts of the package that a module may import. None allows all, as for the surfaces."""
    parts = name.split(".")[1:]
    match parts:
        case ["contract" | "kernel", *_]:
            return (f"{PACKAGE}.kernel", f"{PACKAGE}.contract")
        case ["supervisors", *_]:
            return (f"{PACKAGE}.kernel", f"{PACKAGE}.contract", f"{PACKAGE}.supervisors")
        case ["drivers"]:
            return (f"{PACKAGE}.kernel", f"{PACKAGE}.contract")
        case ["drivers", "common", *_]:
            return (f"{PACKAGE}.kernel", f"{PACKAGE}.contract", f"{PACKAGE}.drivers.common")
        case ["drivers", wire, *_]:
            return (
                f"{PACKAGE}.kernel",
                f"{PACKAGE}.contract",
                f"{PACKAGE}.drivers.common",
                f"{PACKAGE}.drivers.{wire}",
            )
    return None


def faults(name: str, imports: list[Import]) -> list[str]:
    """Return the imports of a module that are not allowed."""
    found = []
    for line, target in imports:
        if is_in(target, "drivers", "supervisors"):
            found.append(f"{name}:{line} imports {target}: a user's own folder of that name would shadow it")
        if not is_in(target, PACKAGE):
            continue
        may = allowed(name)
        if may is not None:
            if not is_in(module_of(target), *may):
                found.append(f"{name}:{line} imports {target}; it may import {', '.join(may)}")
        elif is_in(module_of(target), f"{PACKAGE}.drivers") and module_of(target) != f"{PACKAGE}.drivers":
            found.append(f"{name}:{line} imports {target}: a driver is loaded by name, through the registry")
    return found


def cycles(graph: dict[str, set[str]]) -> list[list[str]]:
    """Return one path for each loop that a depth-first walk finds."""
    found, done = [], set()

    def visit(name: str, path: list[str]) -> None:
        if name in path:
            found.append([*path[path.index(name) :], name])
            return
        if name in done:
            return
        for target in sorted(graph[name]):
            visit(target, [*path, name])
        done.add(name)

    for name in graph:
        visit(name, [])
    return found


def test_the_import_check_reads_the_whole_package() -> None:
    for name in (
        PACKAGE,
        f"{PACKAGE}.kernel.node",
        f"{PACKAGE}.supervisors.gate.gate",
        f"{PACKAGE}.drivers",
        f"{PACKAGE}.drivers.common.ports.half_duplex",
        f"{PACKAGE}.drivers.feetech.wire",
    ):
        assert name in MODULES
    assert not any("/." in str(path) for path in MODULES.values())
    of_gate = {target for _, target in all_imports()[f"{PACKAGE}.supervisors.gate.gate"]}
    assert f"{PACKAGE}.kernel.actor.Actor" in of_gate


def test_a_module_imports_only_lower_modules() -> None:
    assert [fault for name, imports in all_imports().items() for fault in faults(name, imports)] == []


def test_no_module_imports_itself_by_a_detour() -> None:
    """This includes imports for type checkers and imports in functions."""
    graph = {
        name: {module_of(target) for _, target in imports if is_in(target, PACKAGE)} - {name}
        for name, imports in all_imports().items()
    }
    assert cycles({name: targets & set(graph) for name, targets in graph.items()}) == []


# -- the rules themselves


@pytest.mark.parametrize(
    ("name", "source"),
    [
        ("strands_actors.kernel.node", "from ..supervisors import gate"),
        ("strands_actors.kernel.node", "import strands_actors.caller.session.tree"),
        ("strands_actors.kernel.node", "from strands_actors.caller.session import tree"),
        ("strands_actors.kernel.node", "def f():\n  from strands_actors.drivers import WIRES"),
        ("strands_actors.supervisors.gate.gate", "from ...drivers.feetech import wire"),
        ("strands_actors.supervisors.gate.gate", "from strands_actors.caller.processes import run_directory"),
        ("strands_actors.drivers", "from .feetech.driver import Feetech"),
        ("strands_actors.drivers.common.physics.physics", "from ...feetech import axes"),
        ("strands_actors.drivers.feetech.wire", "from ...supervisors.gate.gate import Gate"),
        ("strands_actors.drivers.feetech.wire", "from .. import list_native_drivers"),
        ("strands_actors.caller.session.tree", "from ...drivers.feetech.driver import Feetech"),
        ("strands_actors.caller.session.tree", "import drivers"),
        ("strands_actors.caller.session.tree", "import drivers.feetech.wire"),
        ("strands_actors.caller.session.tree", "from supervisors import gate"),
        ("strands_actors.caller.session.tree", "if TYPE_CHECKING:\n  pass\nelse:\n  import supervisors"),
        ("strands_actors.kernel.node", "if TYPE_CHECKING:\n  from ..caller.session.tree import RobotTree"),
    ],
)
def test_a_fault_is_found(name: str, source: str) -> None:
    is_package = name == "strands_actors.drivers"
    assert len(faults(name, list(imports_of(name, is_package, source)))) == 1


@pytest.mark.parametrize(
    ("name", "source"),
    [
        ("strands_actors.kernel.node", "import trio\nfrom .actor import Actor\nfrom . import link"),
        (
            "strands_actors.supervisors.gate.gate",
            "from ...kernel.actor import Actor\nfrom .lease import Lease",
        ),
        (
            "strands_actors.drivers.feetech.wire",
            "from ..common.ports.half_duplex import X\nfrom .protocol import Y",
        ),
        (
            "strands_actors.caller.session.tree",
            "from ..drivers import WIRES\nfrom ..supervisors.gate.gate import Gate",
        ),
    ],
)
def test_an_allowed_import_is_not_reported(name: str, source: str) -> None:
    assert faults(name, list(imports_of(name, False, source))) == []


def test_a_cycle_is_found() -> None:
    assert cycles({"a": {"b"}, "b": {"c"}, "c": {"b"}, "d": {"a"}}) == [["b", "c", "b"]]
    assert cycles({"a": {"b", "c"}, "b": {"c"}, "c": set()}) == []


def test_a_cycle_for_type_checkers_is_found() -> None:
    sources = {"a.b": "if TYPE_CHECKING:\n  from .c import C", "a.c": "from a.b import B"}
    graph = {
        name: {target.rpartition(".")[0] for _, target in imports_of(name, False, source)}
        for name, source in sources.items()
    }
    assert cycles({name: targets & set(graph) for name, targets in graph.items()}) == [["a.b", "a.c", "a.b"]]


ROOMS = {
    "strands_actors.caller": {
        "handle": {"poses", "session", "processes", "resolve"},
        "poses": {"session"},
        "session": {"processes"},
        "resolve": {"processes"},
        "processes": set(),
    },
    "strands_actors.drivers.common": {
        "kit": {"ports", "codecs"},
        "ports": {"codecs"},
        "codecs": set(),
        "kinematics": set(),
        "physics": {"kinematics"},
        "servo": {"kinematics", "kit", "ports"},
        "dynamixel": {"kit", "physics", "ports", "servo", "twin"},
        "rtps": {"codecs"},
        "simulation_control": {"codecs", "physics"},
        "twin": {"codecs", "physics", "ports", "rtps", "simulation_control"},
    },
}
"""The rooms (parts) of a package, with the rooms that each may import."""


@pytest.mark.parametrize("package", ROOMS)
def test_rooms_import_only_the_rooms_below_them(package: str) -> None:
    arrows: dict[str, set[str]] = {room: set() for room in ROOMS[package]}
    for name, imports in all_imports().items():
        room = name.removeprefix(f"{package}.").partition(".")[0]
        if name.startswith(f"{package}.") and room in arrows:
            targets = (target for _, target in imports if target.startswith(f"{package}."))
            arrows[room] |= {target.removeprefix(f"{package}.").partition(".")[0] for target in targets} - {room}
    assert arrows == ROOMS[package]
