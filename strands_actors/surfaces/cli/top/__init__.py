"""``top``: show the running robots live. Keys stop, e-stop or resume the selected robot."""

from __future__ import annotations

import sys

from strands_actors.contract.extras import require
from strands_actors.surfaces.cli.errors import Problem


def run() -> int:
    if not (sys.stdin.isatty() and sys.stdout.isatty()):
        raise Problem("top: this needs a terminal. Use `strands-actors tree`, which prints the robots once")
    require("top", "top")
    from .app import Top
    from .leaving import ends_with_its_terminal

    app = Top()
    with ends_with_its_terminal(app.leave):
        app.run()
    return app.return_code or 0
