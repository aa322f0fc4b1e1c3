"""Every refusal has a code and a text of a catalogue, every code is used, and ``docs/refusals.md`` lists them all.

A catalogue is a module called ``refusals``: an enum of codes, and one function for each text. Only the functions
of a catalogue construct a ``Refused``, so that whoever looks for a text finds it in one place.

``python -m tests.house.test_refusals`` writes the page.
"""

from __future__ import annotations

import ast
import functools
import importlib
import re
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from strands_actors.kernel.refusals import RefusalCode

from .test_imports import MODULES, PACKAGE, ROOT, all_imports, trees

PAGE = ROOT / "docs" / "refusals.md"
HEAD = """# Refusals

A refusal has a code: in an envelope under `refused`, on the mesh under `refused` of an error, in
Python as `Refused.code`. Programs decide by the code. `reason` and `remedy` are for people and may
change. `because` is the reason for the robot's present stop, as in `Status`.

The texts below have the names of values in braces. This page is generated from the catalogues (the
modules called `refusals.py`) by `python -m tests.house.test_refusals`.
"""
PASSED_ON = re.compile(r"\{[^{}]*\}")
"""A text that comes from elsewhere as a whole."""
TEST_ROBOTS = f"{PACKAGE}.testing."
"""Test robots have codes and texts of their own."""


class Text(NamedTuple):
    """One function of a catalogue."""

    module: str
    function: str
    codes: frozenset[str]  # as ``Code.BUSY``; empty if the caller gives the code
    reasons: tuple[str, ...]  # with the names of values in braces


def catalogues() -> dict[str, type[RefusalCode]]:
    """Return each enum of codes by the name of its module."""
    found: dict[str, type[RefusalCode]] = {}
    for name in sorted(MODULES):
        if is_catalogue(name):
            for each in vars(importlib.import_module(name)).values():
                if (
                    isinstance(each, type)
                    and issubclass(each, RefusalCode)
                    and each.__module__ == name
                    and len(each)
                ):
                    found[name] = each
    return found


def is_catalogue(module: str) -> bool:
    return module.rpartition(".")[2] == "refusals"


def codes_in(node: ast.AST) -> frozenset[str]:
    """Return the codes that the source names, as ``Code.BUSY``."""
    return frozenset(
        f"{each.value.id}.{each.attr}"
        for each in ast.walk(node)
        if isinstance(each, ast.Attribute) and isinstance(each.value, ast.Name) and each.value.id.endswith("Code")
    )


def constructions(node: ast.AST) -> Iterator[ast.Call]:
    """Yield the calls that construct a ``Refused``."""
    for each in ast.walk(node):
        if isinstance(each, ast.Call) and isinstance(each.func, ast.Name) and each.func.id == "Refused":
            yield each


def shown(expression: ast.expr, assigned: dict[str, ast.expr]) -> str:
    """Return the text that an expression gives, with the names of values in braces."""
    match expression:
        case ast.Constant(value=str(text)):
            return text
        case ast.JoinedStr(values=parts):
            return "".join(shown(part, assigned) for part in parts)
        case ast.FormattedValue(value=value) | ast.Subscript(value=value) | ast.Call(args=[value]):
            return shown(value, assigned)
        case ast.Call(func=ast.Attribute(value=value), args=[]):
            return shown(value, assigned)
        case ast.Name(id=name):
            others = {key: value for key, value in assigned.items() if key != name}
            return shown(assigned[name], others) if name in assigned else f"{{{name}}}"
        case ast.BinOp(left=left, op=ast.Add(), right=right):
            return shown(left, assigned) + shown(right, assigned)
        case ast.IfExp(body=body, orelse=other):
            return " / ".join(filter(None, (shown(body, assigned), shown(other, assigned))))
    # A text within a text has other quotes in other versions of Python.
    return f"{{{ast.unparse(expression)}}}".replace('"', "'")


def assignments(function: ast.FunctionDef | ast.AsyncFunctionDef) -> Iterator[tuple[str, ast.expr]]:
    """Yield the local names of a function with the expressions that they stand for."""
    for each in ast.walk(function):
        match each:
            case ast.Assign(targets=[ast.Name(id=name)], value=value):
                yield name, value
            case ast.Assign(targets=[ast.Tuple(elts=names)], value=ast.Tuple(elts=values)) if len(names) == len(
                values
            ):
                yield from (
                    (name.id, value)
                    for name, value in zip(names, values, strict=True)
                    if isinstance(name, ast.Name)
                )


@functools.cache
def texts() -> dict[tuple[str, str], Text]:
    """Return each function of the catalogues by its module and name."""
    found = {}
    for module, tree in trees().items():
        if not is_catalogue(module):
            continue
        for function in tree.body:
            if not isinstance(function, ast.FunctionDef):
                continue
            assigned = dict(assignments(function))
            texts_shown = (shown(call.args[1], assigned) for call in constructions(function) if len(call.args) > 1)
            own = tuple(each for each in texts_shown if not PASSED_ON.fullmatch(each))
            found[module, function.name] = Text(module, function.name, codes_in(function), own)
    return found


def written(node: ast.AST) -> str:
    """Return a name, or an attribute of a name, as it is written; empty for anything else."""
    match node:
        case ast.Name(id=name):
            return name
        case ast.Attribute(value=ast.Name(id=name), attr=attribute):
            return f"{name}.{attribute}"
    return ""


@functools.cache
def calls() -> dict[tuple[str, str], set[str]]:
    """Return the modules that call each function of a catalogue, also by way of another such function."""
    found: dict[tuple[str, str], set[str]] = {each: set() for each in texts()}
    between: list[tuple[tuple[str, str], tuple[str, str]]] = []
    for module, tree in trees().items():
        reached = _reached(module)
        for top in tree.body:
            by = (module, top.name) if isinstance(top, ast.FunctionDef) else ("", "")
            for node in ast.walk(top):
                called = reached.get(written(node))
                if called is None:
                    continue
                if by in found:
                    between.append((by, called))
                else:
                    found[called].add(module)
    for _ in range(3):
        for by, called in between:
            found[called] |= found[by]
    return found


def _reached(module: str) -> dict[str, tuple[str, str]]:
    """Return the functions of catalogues that a module can call, by how it writes them."""
    reached = {name: (module, name) for of, name in texts() if of == module}
    for each in all_imports()[module]:
        base, _, name = each.target.rpartition(".")
        if (base, name) in texts():
            reached[name] = (base, name)
        elif is_catalogue(each.target):
            reached |= {f"refusals.{function}": (of, function) for of, function in texts() if of == each.target}
    return reached


@functools.cache
def reasons() -> dict[str, set[str]]:
    """Return the texts that go with each code, ``Class.MEMBER``. Some functions get the code from their caller."""
    found: dict[str, set[str]] = {}
    for text in texts().values():
        for code in text.codes:
            found.setdefault(code, set()).update(text.reasons)
    for module, tree in trees().items():
        reached = _reached(module)
        for node in ast.walk(tree):
            called = reached.get(written(node.func)) if isinstance(node, ast.Call) else None
            if called is not None and isinstance(node, ast.Call) and node.args:
                for code in codes_in(node.args[0]):
                    found.setdefault(code, set()).update(texts()[called].reasons)
    return found


@functools.cache
def used() -> dict[str, set[str]]:
    """Return the modules that refuse with each code, ``Class.MEMBER``."""
    where: dict[str, set[str]] = {}
    for module, tree in trees().items():
        if not is_catalogue(module):
            for code in codes_in(tree):
                where.setdefault(code, set()).add(module)
    for each, modules in calls().items():
        for code in texts()[each].codes:
            where.setdefault(code, set()).update(modules)
    return {code: {each.removeprefix(f"{PACKAGE}.") for each in modules} for code, modules in where.items()}


def page() -> str:
    where = used()
    text = [HEAD]
    for name, kind in sorted(catalogues().items(), key=lambda each: (each[1].__name__ != "Code", each[0])):
        title = "Of every robot" if kind.__name__ == "Code" else f"`drivers.{name.split('.')[-2]}`"
        text += [f"## {title}", "", "| code | meaning | what to do | texts | from |", "|---|---|---|---|---|"]
        for code in sorted(kind, key=str):
            member = f"{kind.__name__}.{code.name}"
            modules = ", ".join(f"`{each}`" for each in sorted(where.get(member, ())))
            shown_texts = "<br>".join(each.replace("|", "\\|") for each in sorted(reasons().get(member, ())))
            text.append(f"| `{code}` | {code.meaning} | {code.remedy} | {shown_texts} | {modules} |")
        text.append("")
    return "\n".join(text)


def test_the_page_has_every_code_and_text() -> None:
    assert PAGE.read_text() == page(), "python -m tests.house.test_refusals writes it"


def test_every_code_is_used() -> None:
    where = used()
    idle = [f"{kind.__name__}.{code.name}" for kind in catalogues().values() for code in kind]
    assert not [each for each in idle if not where.get(each)]


def test_every_text_is_used() -> None:
    assert not [f"{module}.{function}" for (module, function), modules in calls().items() if not modules]


def test_only_a_catalogue_has_the_text_of_a_refusal() -> None:
    elsewhere = [
        f"{module}:{call.lineno}"
        for module, tree in trees().items()
        if not is_catalogue(module) and not module.startswith(TEST_ROBOTS)
        if any(each.target == f"{PACKAGE}.kernel.messages.Refused" for each in all_imports()[module])
        for call in constructions(tree)
    ]
    assert not elsewhere, "write a function in the refusals.py of the package, and call it"


def test_a_refusal_has_a_code_of_an_enum() -> None:
    literal = [
        f"{module}:{call.lineno}"
        for module, tree in trees().items()
        if not module.startswith(TEST_ROBOTS)
        for call in constructions(tree)
        if len(call.args) > 1 and isinstance(call.args[0], ast.Constant)
    ]
    assert not literal, "a code of strands_actors.kernel.refusals, or of the driver's own refusals"


if __name__ == "__main__":
    Path(PAGE).write_text(page())
