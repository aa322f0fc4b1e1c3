"""Find the packages that are not installed: required ones, and those of the extras (optional packages)."""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Sequence
from importlib import metadata

DISTRIBUTION = "strands-actors"
FOR_DEVELOPERS = frozenset({"bench", "docs", "release", "test"})
"""Extras for work on this package."""


def install_command(extra: str) -> str:
    return f"pip install '{DISTRIBUTION}[{extra}]'"


def missing_extras() -> dict[str, str]:
    """Return the command that installs an extra, for each extra that is not installed. The result is empty if this
    package runs from its source, without an installation."""
    try:
        requirements = metadata.requires(DISTRIBUTION) or []
    except metadata.PackageNotFoundError:
        return {}
    absent = missing_requirements(requirements)
    return {extra: install_command(extra) for extra, packages in sorted(absent.items()) if extra and packages}


def missing_requirements(requirements: Sequence[str]) -> dict[str, list[str]]:
    """Return the packages that are not installed, by extra. The key "" has the required packages. The extras of
    ``FOR_DEVELOPERS`` are left out."""
    missing_packages: dict[str, list[str]] = {"": []}
    for requirement in requirements:
        spec, _, marker = requirement.partition(";")
        extra = re.search(r"extra\s*==\s*['\"]([^'\"]+)['\"]", marker)
        name = re.match(r"[A-Za-z0-9._-]+", spec.strip())
        if name is None or name[0] == DISTRIBUTION or (extra and extra[1] in FOR_DEVELOPERS):
            continue  # The extra [all] lists this package, with its other extras.
        if not (_is_for_this_python(marker) and _is_for_this_machine(marker)):
            continue
        absent = missing_packages.setdefault(extra[1] if extra else "", [])
        try:
            metadata.version(name[0])
        except metadata.PackageNotFoundError:
            absent.append(name[0])
    return missing_packages


def _is_for_this_python(marker: str) -> bool:
    version = sys.version_info[:2]
    for operator, major, minor in re.findall(r"python_version\s*(<=|>=|<|>)\s*['\"](\d+)\.(\d+)['\"]", marker):
        limit = (int(major), int(minor))
        holds = {"<": version < limit, "<=": version <= limit, ">": version > limit, ">=": version >= limit}[
            operator
        ]
        if not holds:
            return False
    return True


def _is_for_this_machine(marker: str) -> bool:
    others: list[str] = re.findall(r"platform_machine\s*!=\s*['\"]([^'\"]+)['\"]", marker)
    return os.uname().machine not in others
