"""How another Python is started: it imports from where this process does, and from nowhere else."""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping

PYTHON = (sys.executable, "-P")
"""``-P``: without it the current directory comes first, and whatever ``msgspec.py`` lies there runs
in the processes of a robot."""


def environment(**more: str) -> Mapping[str, str]:
    """Return that of a child: ours, with our import path, a user's own modules included."""
    path = os.pathsep.join(path or os.getcwd() for path in sys.path)  # empty: an interpreter that is typed into
    return {**os.environ, "PYTHONPATH": path, **more}
