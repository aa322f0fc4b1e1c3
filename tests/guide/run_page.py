"""Run the Python blocks of a page in order, in this process: ``python -m tests.guide.run_page PAGE``.

The process ends with an error at the first block that raises an exception, or that prints another output
than its comments announce. ``--on-twins`` runs examples for real robots on twins (``on_twins``), and compares no
output. A block that needs LeRobot is left out. Further arguments are the numbers of the blocks to run, from 1. By
default all run.
"""

from __future__ import annotations

import contextlib
import io
import sys
import time
from collections.abc import Collection
from pathlib import Path
from types import ModuleType

from .blocks import agrees, announced, blocks_of
from .on_twins import CHECK, answered, on_twins

ON_TWINS = "--on-twins"


def run(page: Path, chosen: Collection[int] = (), twins: bool = False) -> None:
    # A new module, so that a block has no name that the page does not define.
    main = sys.modules["__main__"] = ModuleType("__main__")
    blocks = [block for block in blocks_of(page) if block.language == "python"]
    for number, block in enumerate(blocks, 1):
        if block.needs_lerobot or (chosen and number not in chosen):
            continue
        place = f"{page.name}:{block.line}"
        # The line numbers of an exception are then those of the page.
        source = "\n" * (block.line - 1) + block.source
        if twins:
            main.__dict__[CHECK] = answered
        code = compile(on_twins(source) if twins else source, str(page), "exec")
        printed, began_s = io.StringIO(), time.monotonic()
        with contextlib.redirect_stdout(printed):
            exec(code, main.__dict__)
        print(f"{place}: {time.monotonic() - began_s:.1f} s\n{printed.getvalue()}", flush=True)
        expected = "\n".join(announced(block.source))
        if not twins and not agrees(expected, printed.getvalue()):
            raise SystemExit(f"{place}: the page announces another output:\n{expected}")


if __name__ == "__main__":
    arguments = [argument for argument in sys.argv[1:] if argument != ON_TWINS]
    run(Path(arguments[0]), set(map(int, arguments[1:])), ON_TWINS in sys.argv)
