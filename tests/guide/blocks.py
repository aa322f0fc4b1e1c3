"""Find the code blocks of a page, and the output that a Python block announces.

A comment behind ``print(...)``, and the comment lines directly below it, are the output of this call::

    print(arm.get_observation()["shoulder_pan"])  # 9.9
    print(arm.send_action({"shoulder_pan": 400.0}))
    # {'status': 'error', ... 'shoulder_pan 400.0 deg is past 110.1' ...}
"""

from __future__ import annotations

import ast
import io
import re
import textwrap
import tokenize
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

FENCE = re.compile(r"^( *)```(\w+)\n(.*?)^ *```$", re.DOTALL | re.MULTILINE)
NEEDS_LEROBOT = "<!-- needs LeRobot -->"
ANYTHING = "..."
NUMBER = re.compile(r"(?<![\w.])-?\d+\.\d+(?!\w|\.[\d.])")
TOLERANCE = 2.0
"""How far a measured number may be from the number on the page. The twins have physics and noise."""


class Block(NamedTuple):
    """A fenced block of a page."""

    line: int
    language: str
    source: str
    needs_lerobot: bool = False
    """True if the comment ``NEEDS_LEROBOT`` stands above it. ``tests/lerobot`` runs it."""


def blocks_of(page: Path) -> Iterator[Block]:
    text = page.read_text()
    for fence in FENCE.finditer(text):
        marked = text[: fence.start()].rstrip().endswith(NEEDS_LEROBOT)
        yield Block(text.count("\n", 0, fence.start()) + 2, fence[2], textwrap.dedent(fence[3]), marked)


def announced(source: str) -> list[str]:
    """Return the lines of output that the comments of a Python block announce."""
    comments = {
        token.start[0]: (token.string.lstrip("#").strip(), token.line.lstrip().startswith("#"))
        for token in tokenize.generate_tokens(io.StringIO(source).readline)
        if token.type == tokenize.COMMENT
    }
    output = []
    for call in ast.walk(ast.parse(source)):
        if not (isinstance(call, ast.Call) and isinstance(call.func, ast.Name) and call.func.id == "print"):
            continue
        line = call.end_lineno or call.lineno
        if line in comments:
            output.append((line, comments[line][0]))
        while comments.get(line + 1, ("", False))[1]:
            line += 1
            output.append((line, comments[line][0]))
    return [text for _, text in sorted(output)]


def agrees(expected: str, printed: str) -> bool:
    """Return whether an output is the announced one.

    Args:
        expected: The announced output. ``...`` stands for any text. A number with a decimal point stands for all
            numbers that differ from it by ``TOLERANCE`` at most.
        printed: The output.
    """
    pattern = ""
    numbers = []
    for part in re.split(rf"({re.escape(ANYTHING)}|{NUMBER.pattern})", " ".join(expected.split())):
        if part == ANYTHING:
            pattern += ".*?"
        elif NUMBER.fullmatch(part):
            pattern += r"(-?\d+(?:\.\d+)?)"
            numbers.append(float(part))
        else:
            pattern += re.escape(part)
    found = re.fullmatch(pattern, " ".join(printed.split()), re.DOTALL)
    return found is not None and all(
        abs(float(measured) - number) <= TOLERANCE for measured, number in zip(found.groups(), numbers, strict=True)
    )
