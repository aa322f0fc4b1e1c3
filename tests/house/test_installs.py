"""The package installs where robots are: on x86-64 and aarch64, without a compiler, on every Python
it names. The package index is asked; a part without a wheel fails here, not on somebody's robot."""

from __future__ import annotations

import ast
import json
import subprocess
import sys
import tomllib
from collections.abc import Iterable, Iterator
from importlib import metadata

import pytest
from packaging.markers import default_environment
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from strands_actors.contract.extras import EXTRAS
from strands_actors.drivers.ur.sdk import install_line

from .test_imports import MODULES, PACKAGE, ROOT

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
PYTHONS = ("3.11", "3.12", "3.13")
MACHINES = ("x86_64", "aarch64")
GLIBC = range(17, 29)
"""manylinux_2_17 to 2_28: what Raspberry Pi OS 12 (2.36), JetPack 6 (2.35) and Debian 11 (2.31)
take."""

RESOLVE_S = 240.0
FOR_OTHERS = ("test", "bench", "lerobot", "newton")
"""Extras that nobody needs on a robot: lerobot brings torch, and Warp has no wheels for glibc below
2.34 on aarch64."""


def wanted(python: str, machine: str, extras: Iterable[str]) -> list[str]:
    """Return what pip is asked for on such a machine. Our own markers are decided here: pip decides
    them for the machine it runs on."""
    lines = [*PROJECT["dependencies"]]
    for extra in extras:
        lines += PROJECT["optional-dependencies"][extra]
    there = {**default_environment(), "python_version": python, "platform_machine": machine, "extra": ""}
    found = (Requirement(line) for line in lines)
    return [
        f"{one.name}{_extras(one)}{one.specifier}"
        for one in found
        if one.name != PROJECT["name"] and (one.marker is None or one.marker.evaluate(there))
    ]


def _extras(requirement: Requirement) -> str:
    return f"[{','.join(sorted(requirement.extras))}]" if requirement.extras else ""


def resolve(python: str, machine: str, requirements: list[str]) -> list[str]:
    """Return the files that pip would install. What has no wheel fails, with pip's own words."""
    command = [sys.executable, "-m", "pip", "install", "--dry-run", "--ignore-installed", "--quiet"]
    command += ["--report", "-", "--only-binary", ":all:", "--target", "nowhere", "--no-input"]
    command += ["--implementation", "cp", "--python-version", python]
    for minor in GLIBC:
        command += ["--platform", f"manylinux_2_{minor}_{machine}"]
    command += ["--platform", f"manylinux2014_{machine}", *requirements]
    done = subprocess.run(command, capture_output=True, text=True, timeout=RESOLVE_S, check=False)
    assert done.returncode == 0, f"Python {python} on {machine}:\n{done.stderr}"
    return [one["download_info"]["url"].rpartition("/")[2] for one in json.loads(done.stdout)["install"]]


@pytest.mark.parametrize("machine", MACHINES)
@pytest.mark.parametrize("python", PYTHONS)
def test_everything_that_a_robot_needs_has_a_wheel(python: str, machine: str) -> None:
    extras = [name for name in PROJECT["optional-dependencies"] if name not in FOR_OTHERS]
    files = resolve(python, machine, wanted(python, machine, extras))
    assert [name for name in files if not name.endswith(".whl")] == []
    names = {name.partition("-")[0].lower().replace("_", "-") for name in files}
    assert {"trio", "eclipse-zenoh", "mujoco-core", "textual"} <= names
    assert ("ur-rtde" in names) == (machine == "x86_64" and python != "3.13")


def test_a_package_without_a_wheel_is_found() -> None:
    with pytest.raises(AssertionError, match=r"Python 3\.12 on aarch64(.|\n)*ur-rtde"):
        resolve("3.12", "aarch64", ["ur-rtde==1.6.5"])


def test_the_pythons_are_those_that_the_package_names() -> None:
    named = [line.rpartition(" ")[2] for line in PROJECT["classifiers"] if "Python :: 3." in line]
    assert tuple(named) == PYTHONS


# -- what is imported is declared


def third_party(source: str) -> Iterator[str]:
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            yield from (alias.name.partition(".")[0] for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and not node.level:
            yield (node.module or "").partition(".")[0]


def declared(lines: Iterable[str]) -> set[str]:
    return {canonicalize_name(Requirement(line).name) for line in lines}


BROUGHT = {
    "rclpy": "on the robot", "draccus": "by lerobot", "warp": "by newton",
    "isaacsim": "by who has a card for it", "omni": "by isaacsim",
}  # fmt: skip
"""Modules that are declared by whoever brings them."""


def test_whatever_is_imported_is_declared() -> None:
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
        assert {canonicalize_name(owner) for owner in owners[module]} & brought, module


def test_where_ur_rtde_has_no_wheel_its_line_says_so() -> None:
    assert install_line("x86_64", (3, 12)) == "pip install 'strands-actors[ur]'"
    assert "no wheel for aarch64 with Python 3.12" in install_line("aarch64", (3, 12))
    assert "no wheel for x86_64 with Python 3.13" in install_line("x86_64", (3, 13))
