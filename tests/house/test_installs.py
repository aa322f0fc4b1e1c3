"""The package installs on the computers of robots: x86-64 and aarch64, without a compiler, with every Python
that it names. These tests ask the package index, so that a dependency without a wheel fails here and not on a
user's robot."""

from __future__ import annotations

import ast
import subprocess
import sys
import tomllib
from collections.abc import Iterable, Iterator
from importlib import metadata

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from strands_actors.contract.extras import EXTRAS
from strands_actors.drivers.ur.sdk import install_line

from .test_imports import MODULES, PACKAGE, ROOT

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
PYTHONS = ("3.11", "3.12", "3.13", "3.14")
MACHINES = ("x86_64", "aarch64")
GLIBC = "manylinux_2_28"
"""Newest glibc that Raspberry Pi OS 12 (2.36), JetPack 6 (2.35) and Debian 11 (2.31) all have."""
GLIBC_OF_TESTS = "manylinux_2_36"
"""Some vendors' clients need a newer glibc, which Debian 12 has."""
SOURCES = {"feetech-servo-sdk"}
"""Packages of the extra ``test`` that are pure Python and have no wheel. pip builds them without a compiler."""

RESOLVE_S = 240.0
FOR_OTHERS = ("test", "bench", "docs", "release", "lerobot", "newton")
"""Extras that are not needed on a robot: lerobot brings torch, and Warp has no aarch64 wheels for glibc below
2.34."""


def wanted(extras: Iterable[str]) -> list[str]:
    """Return the requirements of the package and of these extras."""
    lines = [*PROJECT["dependencies"]]
    for extra in extras:
        lines += PROJECT["optional-dependencies"][extra]
    return [line for line in lines if Requirement(line).name != PROJECT["name"]]


def resolve(python: str, machine: str, requirements: list[str], glibc: str = GLIBC) -> set[str]:
    """Return the names of the packages that would be installed on that machine. A package without a wheel fails
    with the message of uv. uv evaluates markers for that machine and takes a tenth of pip's time."""
    command = [sys.executable, "-m", "uv", "pip", "compile", "-", "--quiet", "--no-config", "--no-annotate"]
    command += ["--only-binary", ":all:", "--python", sys.executable, "--python-version", python]
    command += ["--python-platform", f"{machine}-{glibc}", "--no-header"]
    done = subprocess.run(
        command, input="\n".join(requirements), capture_output=True, text=True, timeout=RESOLVE_S, check=False
    )
    assert done.returncode == 0, f"Python {python} on {machine}:\n{done.stderr}"
    return {canonicalize_name(Requirement(line).name) for line in done.stdout.splitlines()}


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize("machine", MACHINES)
@pytest.mark.parametrize("python", PYTHONS)
def test_everything_that_a_robot_needs_has_a_wheel(python: str, machine: str) -> None:
    extras = [name for name in PROJECT["optional-dependencies"] if name not in FOR_OTHERS]
    names = resolve(python, machine, wanted(extras))
    assert {"trio", "eclipse-zenoh", "mujoco-core", "textual"} <= names
    assert ("ur-rtde" in names) == (machine == "x86_64" and python in ("3.11", "3.12"))


@pytest.mark.long
@pytest.mark.parametrize("machine", MACHINES)
@pytest.mark.parametrize("python", PYTHONS)
def test_everything_that_the_tests_need_has_a_wheel_or_is_left_out(python: str, machine: str) -> None:
    """The README's second command installs them. A marker leaves out a package without a wheel
    (``tests/machines.py``)."""
    extras = ("all", "dataset", "docs", "reachy", "test")
    lines = [line for line in wanted(extras) if Requirement(line).name not in SOURCES]
    names = resolve(python, machine, lines, GLIBC_OF_TESTS)
    assert {"pytest", "xarm-python-sdk", "booster-robotics-sdk-python"} <= names


def test_a_package_without_a_wheel_is_found() -> None:
    with pytest.raises(AssertionError, match=r"Python 3\.12 on aarch64(.|\n)*ur-rtde"):
        resolve("3.12", "aarch64", ["ur-rtde==1.6.5"])


def test_the_pythons_are_those_that_the_package_names() -> None:
    named = [line.rpartition(" ")[2] for line in PROJECT["classifiers"] if "Python :: 3." in line]
    assert tuple(named) == PYTHONS


# -- every imported package is declared


def third_party(source: str) -> Iterator[str]:
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            yield from (alias.name.partition(".")[0] for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and not node.level:
            yield (node.module or "").partition(".")[0]


def declared(lines: Iterable[str]) -> set[str]:
    return {canonicalize_name(Requirement(line).name) for line in lines}


BROUGHT = {
    "draccus": "by lerobot", "warp": "by newton",
    "isaacsim": "by who has a card for it", "omni": "by isaacsim", "rerun": "by rerun-sdk",
}  # fmt: skip
"""Modules that come with a declared package."""


def test_every_imported_package_is_declared() -> None:
    extras = PROJECT["optional-dependencies"]
    known = declared(PROJECT["dependencies"]).union(*(declared(lines) for lines in extras.values()))
    owners = metadata.packages_distributions()
    undeclared = {
        f"{name} imports {module}"
        for name, path in MODULES.items()
        for module in third_party(path.read_text())
        if module != PACKAGE and module not in sys.stdlib_module_names and module not in BROUGHT
        if not {canonicalize_name(owner) for owner in owners.get(module, [module])} & known
    }
    assert undeclared == set()


@pytest.mark.parametrize("extra", EXTRAS)
def test_an_extra_that_a_message_names_brings_its_modules(extra: str) -> None:
    lines = PROJECT["optional-dependencies"][extra]
    owners = metadata.packages_distributions()
    brought = declared(lines) | {
        canonicalize_name(Requirement(line).name)
        for name in declared(lines)
        for line in metadata.requires(name) or []
    }
    for module in EXTRAS[extra]:
        assert {canonicalize_name(owner) for owner in owners[module.partition(".")[0]]} & brought, module


def test_the_requirement_of_ur_rtde_leaves_out_machines_without_a_wheel() -> None:
    assert install_line("x86_64", (3, 12)) == "pip install 'strands-actors[ur]'"
    assert "no wheel for aarch64 with Python 3.12" in install_line("aarch64", (3, 12))
    assert "no wheel for x86_64 with Python 3.13" in install_line("x86_64", (3, 13))
