"""Describe the gates and conditions of a driver, from their docstrings and the codes of their refusals."""

from __future__ import annotations

import ast
import functools
import inspect
import re
import textwrap
import types
from collections.abc import Callable, Iterator
from typing import NamedTuple

from strands_actors.kernel.refusals import RefusalCode

OURS = "strands_actors."


class GateFacts(NamedTuple):
    """A gate or condition of a driver."""

    name: str
    about: str
    codes: tuple[RefusalCode, ...]


def gate_facts(check: Callable[..., object]) -> GateFacts:
    """Return a description of a gate or condition.

    The text is its docstring, or that of the function that makes it. Without one, the text has the meanings of the
    codes with which it refuses.
    """
    function = _function(check)
    maker = _maker(function)
    about = _first_paragraph(maker) or _first_paragraph(function)
    wrapped = _gates_in(function)
    if about.startswith("Wrap") and len(wrapped) == 1:
        return gate_facts(wrapped[0])
    codes = tuple(sorted(_codes(function, set()) | _codes(maker, set())))
    if not about:
        about = f"Refuse if {', or '.join(code.meaning for code in codes)}."
    return GateFacts(function.__name__.strip("_"), about, codes)


def _function(check: Callable[..., object]) -> types.FunctionType:
    while isinstance(check, functools.partial):
        check = check.func
    function = inspect.unwrap(getattr(check, "__func__", check))
    assert isinstance(function, types.FunctionType), check
    return function


def _maker(function: types.FunctionType) -> types.FunctionType:
    """Return the function of a module in which a gate was defined: the gate itself, if it is one of these."""
    outer = function.__qualname__.partition(".")[0]
    made = function.__globals__.get(outer, function)
    return made if isinstance(made, types.FunctionType) else function


def _gates_in(function: types.FunctionType) -> list[Callable[..., object]]:
    """Return the gates that a gate holds, because it was made to wrap them."""
    cells = (cell.cell_contents for cell in function.__closure__ or ())
    return [content for content in cells if isinstance(content, types.FunctionType) and _takes_a_candidate(content)]


def _takes_a_candidate(function: types.FunctionType) -> bool:
    return function.__code__.co_varnames[: function.__code__.co_argcount] == ("candidate", "state")


def _first_paragraph(function: types.FunctionType) -> str:
    text = " ".join((inspect.getdoc(function) or "").partition("\n\n")[0].split()).replace("``", "`")
    text = re.sub(r"^Return a (?:gate|refusal) (?:that refuses )?", "Refuse ", text)
    return re.sub(r"^G1: refuse", "Refuse", text)


def _codes(function: types.FunctionType, visited: set[object]) -> set[RefusalCode]:
    """Return the codes that a function, or one that it calls, can refuse with."""
    if function in visited or not function.__module__.startswith(OURS):
        return set()
    visited.add(function)
    codes: set[RefusalCode] = set()
    for value in _named_values(function):
        if isinstance(value, RefusalCode):
            codes.add(value)
        elif isinstance(value, types.FunctionType):
            codes |= _codes(value, visited)
    return codes


def _named_values(function: types.FunctionType) -> Iterator[object]:
    """Yield the values of the names and attributes in a function's source, and of its closure."""
    names, attributes = _names_in(function.__code__)
    yield from map(function.__globals__.get, names)
    for owner_name, attribute in attributes:
        owner = function.__globals__.get(owner_name)
        if isinstance(owner, types.ModuleType) or (isinstance(owner, type) and issubclass(owner, RefusalCode)):
            yield getattr(owner, attribute, None)
    for cell in function.__closure__ or ():
        content = cell.cell_contents
        yield content.func if isinstance(content, functools.partial) else content


@functools.cache
def _names_in(code: types.CodeType) -> tuple[frozenset[str], frozenset[tuple[str, str]]]:
    """Return the names in a function's source, and the attributes of names as pairs."""
    nodes = list(ast.walk(ast.parse(textwrap.dedent(inspect.getsource(code)))))
    names = frozenset(node.id for node in nodes if isinstance(node, ast.Name))
    attributes = frozenset(
        (node.value.id, node.attr)
        for node in nodes
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name)
    )
    return names, attributes
