"""Every refusal has a code from a catalogue, every code is used, and ``docs/refusals.md`` lists all codes.

``python -m tests.house.test_refusals`` writes that page.
"""

from __future__ import annotations

import ast
import functools
import importlib
from pathlib import Path

from strands_actors.kernel.refusals import RefusalCode

from .test_imports import MODULES, PACKAGE, ROOT

PAGE = ROOT / "docs" / "refusals.md"
HEAD = """# Refusals

A refusal has a code: in an envelope under `refused`, on the mesh under `refused` of an error, in
Python as `Refused.code`. Programs decide by the code. `reason` and `remedy` are for people and may
change. `because` is the reason for the robot's present stop, as in `Status`.

This page is generated from the catalogues (`kernel/refusals.py`, and `refusals.py` of a wire) by
`python -m tests.house.test_refusals`.
"""


def catalogues() -> dict[str, type[RefusalCode]]:
    """Return each catalogue by the name of its module."""
    found: dict[str, type[RefusalCode]] = {}
    for name in sorted(MODULES):
        if name.rpartition(".")[2] == "refusals":
            for kind in vars(importlib.import_module(name)).values():
                if isinstance(kind, type) and issubclass(kind, RefusalCode) and len(kind):
                    found[name] = kind
    return found


@functools.cache
def used() -> dict[str, set[str]]:
    """Return the modules that use each member, ``Class.MEMBER``."""
    where: dict[str, set[str]] = {}
    for name, path in MODULES.items():
        for node in ast.walk(ast.parse(path.read_text())):
            if (
                isinstance(node, ast.Attribute)
                and isinstance(node.value, ast.Name)
                and node.value.id.endswith("Code")
            ):
                where.setdefault(f"{node.value.id}.{node.attr}", set()).add(name.removeprefix(f"{PACKAGE}."))
    return where


def page() -> str:
    where = used()
    text = [HEAD]
    for name, kind in sorted(catalogues().items(), key=lambda each: (each[1].__name__ != "Code", each[0])):
        title = "Of every robot" if kind.__name__ == "Code" else f"`drivers.{name.split('.')[-2]}`"
        text += [f"## {title}", "", "| code | meaning | what to do | raised in |", "|---|---|---|---|"]
        for code in sorted(kind, key=str):
            modules = sorted(where.get(f"{kind.__name__}.{code.name}", ()))
            text.append(
                f"| `{code}` | {code.meaning} | {code.remedy} | {', '.join(f'`{each}`' for each in modules)} |"
            )
        text.append("")
    return "\n".join(text)


def test_the_page_has_every_code() -> None:
    assert PAGE.read_text() == page(), "python -m tests.house.test_refusals writes it"


def test_every_code_is_raised_somewhere() -> None:
    where = used()
    idle = [f"{kind.__name__}.{code.name}" for kind in catalogues().values() for code in kind]
    assert not [each for each in idle if each not in where]


def test_a_refusal_has_a_code_of_a_catalogue() -> None:
    literal = [
        f"{name}: {ast.unparse(node)}"
        for name, path in sorted(MODULES.items())
        if not name.startswith(f"{PACKAGE}.testing.")  # test robots have their own codes
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.Call)
        and isinstance(node.func, ast.Name)
        and node.func.id == "Refused"
        and len(node.args) > 1
        and isinstance(node.args[0], ast.Constant)
    ]
    assert not literal, "a code of strands_actors.kernel.refusals, or of the wire's own refusals"


if __name__ == "__main__":
    Path(PAGE).write_text(page())
