"""Write the table of mutations as a page."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .run import Found

HEAD = """# Mutations

Each mutation is a small mistake in the code that makes robots safe: a wait, a motor that is left out,
a condition turned round, a row of a table gone. The tests that hold the place are run until one
fails. `python -m tests mutate --resume FILE --page docs/mutations.md` makes this page.

"""


def write_page(page: Path, found: Sequence[Found], reasons: Mapping[str, Mapping[str, str]]) -> None:
    by_path: dict[str, list[Found]] = defaultdict(list)
    for each in found:
        by_path[each.path].append(each)
    killed = sum(bool(each.by) for each in found)
    text = [f"{HEAD}**{killed} of {len(found)} are noticed ({killed / max(1, len(found)):.1%}).**\n"]
    text += ["| file | mutations | noticed | with a reason | survived |", "|---|---:|---:|---:|---:|"]
    for path, those in sorted(by_path.items()):
        alive = [each for each in those if not each.by]
        excused = sum(each.key in reasons.get(path, {}) for each in alive)
        counts = len(those), len(those) - len(alive), excused, len(alive) - excused
        text.append(f"| `{path}` | {' | '.join(map(str, counts))} |")
    text += ["\n## Survivors\n", "| file | mutation | reason |", "|---|---|---|"]
    for path, those in sorted(by_path.items()):
        for each in sorted((each for each in those if not each.by), key=lambda one: one.line):
            why = reasons.get(path, {}).get(each.key, "none yet: a test is missing")
            text.append(f"| `{path}` | `{each.key.replace('|', '/')}` | {why} |")
    page.write_text("\n".join(text) + "\n")
