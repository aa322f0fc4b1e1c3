"""Run the Python blocks of a page in order, in this process: ``python -m tests.guide.run_page PAGE``.

The process ends with an error at the first block that raises an exception, or that prints another output
than its comments announce.
"""

from __future__ import annotations

import contextlib
import io
import sys
import time
from pathlib import Path
from types import ModuleType

from .blocks import agrees, announced, blocks_of


def run(page: Path) -> None:
    # A new module, so that a block has no name that the page does not define.
    main = sys.modules["__main__"] = ModuleType("__main__")
    for block in blocks_of(page):
        if block.language != "python":
            continue
        place = f"{page.name}:{block.line}"
        # The line numbers of an exception are then those of the page.
        code = compile("\n" * (block.line - 1) + block.source, str(page), "exec")
        printed, began_s = io.StringIO(), time.monotonic()
        with contextlib.redirect_stdout(printed):
            exec(code, main.__dict__)
        print(f"{place}: {time.monotonic() - began_s:.1f} s\n{printed.getvalue()}", flush=True)
        expected = "\n".join(announced(block.source))
        if not agrees(expected, printed.getvalue()):
            raise SystemExit(f"{place}: the page announces another output:\n{expected}")


if __name__ == "__main__":
    run(Path(sys.argv[1]))
