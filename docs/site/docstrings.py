"""Change docstrings into Markdown where they have a layout for an editor.

* A section ``Example`` is code.
* Lines that begin with a name in backticks and two spaces are a list.
* A comment behind a field of a class, or above it, is its docstring.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import griffe

EXAMPLE = re.compile(r"^( *)Example::?\n\n?((?:\1 +.*\n|\n)+(?:\1 +.*)?|\1 +.*)", re.MULTILINE)
BEHIND = re.compile(r"""^[^#"']*(?:(?:"[^"]*"|'[^']*')[^#"']*)*\s#\s(.+)$""")
"""A comment behind code. A sign in a text is no comment."""
TO_TOOLS = re.compile(r"noqa|type: |fmt: |mypy: ")
ROW = re.compile(r"^(``\S.*?``) {2,}(\S.*)$")


def readable(text: str) -> str:
    """Return a docstring as Markdown.

    Args:
        text: The docstring without its indentation.
    """
    return _lists(EXAMPLE.sub(_fenced, text))


def _fenced(example: re.Match[str]) -> str:
    indent, code = example[1], example[2].rstrip("\n")
    inner = f"{indent}    "
    return f"{indent}Example:\n{inner}```python\n{code}\n{inner}```\n\n"


def _lists(text: str) -> str:
    lines: list[str] = []
    in_list = False
    for line in text.split("\n"):
        row = ROW.match(line)
        if row:
            lines += [] if in_list or not (lines and lines[-1].strip()) else [""]
            lines.append(f"* {row[1]}: {row[2]}")
            in_list = True
        elif in_list and line.startswith("  "):
            lines.append(f"    {line.strip()}")
        else:
            in_list = False
            lines.append(line)
    return "\n".join(lines)


def comment_of(lines: list[str], index: int) -> str:
    """Return the comment of a field.

    Args:
        lines: The source of the module.
        index: Index of the line with the field.
    """
    behind = BEHIND.match(lines[index])
    if behind:
        return "" if TO_TOOLS.match(behind[1]) else behind[1]
    above: list[str] = []
    for line in reversed(lines[:index]):
        if not line.strip().startswith("# "):
            break
        above.insert(0, line.strip().removeprefix("# "))
    return "" if above and above[0].startswith("--") else " ".join(above)


class Readable(griffe.Extension):
    """Changes each docstring that the reference shows."""

    def on_object(self, *, obj: griffe.Object, loader: griffe.GriffeLoader, **_: Any) -> None:
        """Change the docstring of a module, class, function or attribute."""
        if obj.docstring is not None:
            obj.docstring.value = readable(obj.docstring.value)
        elif comment := _comment(obj):
            obj.docstring = griffe.Docstring(comment[:1].upper() + comment[1:], parent=obj)


def _comment(obj: griffe.Object) -> str:
    """Return the comment of a field of a class; empty for other objects."""
    is_field = obj.is_attribute and obj.parent is not None and obj.parent.is_class
    if not is_field or not obj.lineno or not isinstance(obj.filepath, Path):
        return ""
    return comment_of(obj.lines_collection[obj.filepath], obj.lineno - 1)
