"""Each started Python ignores the current directory on import. Otherwise a file ``msgspec.py`` there would run."""

from __future__ import annotations

import ast
from pathlib import Path

ROOT = Path(__file__).parents[2]
OWN = "strands_actors/kernel/processes/interpreter.py"


def starts(path: Path) -> list[str]:
    """Return the lists and tuples of a file that begin with ``sys.executable``."""
    found = []
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        if isinstance(node, ast.List | ast.Tuple) and node.elts and ast.unparse(node.elts[0]) == "sys.executable":
            found.append(f"{path.relative_to(ROOT)}:{node.lineno}")
    return found


def test_every_python_is_started_by_one_command() -> None:
    files = [path for top in ("strands_actors", "supervisors", "drivers") for path in (ROOT / top).rglob("*.py")]
    found = [start for path in files for start in starts(path)]
    assert [start.partition(":")[0] for start in found] == [OWN], found
