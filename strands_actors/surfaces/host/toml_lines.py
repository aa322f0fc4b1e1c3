"""Find the line of each key of a TOML file, for messages. Pure.

``tomllib`` gives no lines. So this module splits the text into statements (a table's header, or a key with its
value), and lets ``tomllib`` read each of them alone.
"""

from __future__ import annotations

import tomllib
from typing import Any

Path = tuple[str, ...]


def lines_of(text: str) -> dict[Path, int]:
    """Return the line (from 1) of each table and key, by its path.

    Args:
        text: A valid TOML document. An array of tables, and the keys inside an inline table, have the line of
            their statement.
    """
    lines: dict[Path, int] = {}
    table: Path = ()
    statement, began = "", 0
    for number, line in enumerate(text.splitlines(), 1):
        if not statement:
            if not line.strip() or line.lstrip().startswith("#"):
                continue
            began = number
        statement += line + "\n"
        try:
            parsed = tomllib.loads(statement)
        except tomllib.TOMLDecodeError:
            continue  # The value goes on in the next line: an array, or a text with several lines.
        is_header = statement.lstrip().startswith("[")
        paths = _paths(parsed, () if is_header else table)
        if is_header:
            table = paths[-1]
        for path in paths:
            lines.setdefault(path, began)
        statement = ""
    return lines


def _paths(value: Any, path: Path) -> list[Path]:
    """Return the paths of all keys in a value, the outer ones first. ``path`` is that of the value."""
    if not isinstance(value, dict):
        return []
    paths = []
    for key, part in value.items():
        paths += [(*path, key), *_paths(part, (*path, key))]
    return paths
