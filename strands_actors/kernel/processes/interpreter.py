"""Start another Python that imports from the same places as this process, and from no others."""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping

PYTHON = (sys.executable, "-P")
"""``-P`` keeps the current directory out of the import path. Otherwise a file ``msgspec.py`` there would run in
the processes of a robot."""


def environment(**more: str) -> Mapping[str, str]:
    """Return the environment variables for a child process. They are those of this process, and its import path.

    So a child finds a user's own modules.
    """
    # An empty entry (as in an interactive interpreter) stands for the current directory.
    path = os.pathsep.join(path or os.getcwd() for path in sys.path)
    return {**os.environ, "PYTHONPATH": path, **more}
