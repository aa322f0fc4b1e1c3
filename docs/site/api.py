"""Write the pages of the public packages. mkdocstrings fills them with the docstrings."""

from __future__ import annotations

import importlib
import inspect
from collections.abc import Mapping

from .docstrings import readable

FOLDER = "api"
INDEX = f"{FOLDER}/index.md"

PACKAGES: Mapping[str, str] = {
    "strands_actors": "Robots, recordings and the mesh, for a script.",
    "strands_actors.policies": "Policies, programs that turn observations into actions.",
    "strands_actors.contract": "What the author of a driver imports.",
    "strands_actors.testing": "Twins, faults and checks, for tests.",
}
"""The public packages, with what each is for."""


def place_of(package: str) -> str:
    """Return the place of a package's page in the site."""
    return f"{FOLDER}/{package}.md"


def pages() -> dict[str, str]:
    """Return the page of each public package and the page that lists them, by their place in the site."""
    rows = "\n".join(f"| [`{package}`]({package}.md) | {about} |" for package, about in PACKAGES.items())
    index = (
        "# API reference\n\nAll names of these packages are public, and no others.\n\n"
        f"| package | for |\n|---|---|\n{rows}\n\n"
        "[The page of a robot](../robot/index.md) lists the methods that only this robot has. The commands of the "
        "terminal are on [their page](../command-line.md).\n"
    )
    return {INDEX: index} | {place_of(package): package_page(package) for package in PACKAGES}


def package_page(package: str) -> str:
    """Return the page of a package: its docstring, and a directive of mkdocstrings for each public name."""
    module = importlib.import_module(package)
    lines = [f"# {package}", "", readable(inspect.getdoc(module) or ""), ""]
    for name in sorted(set(module.__all__) - {"__version__"}, key=str.lower):
        lines += [f"::: {package}.{name}", ""]
    return "\n".join(lines)


def navigation() -> list[object]:
    """Return the part of the navigation with the reference."""
    return [INDEX, *({package: place_of(package)} for package in PACKAGES)]
