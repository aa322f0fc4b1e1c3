"""Warn a script that is process 1, as the command of a container is.

When process 1 ends, the kernel kills every other process of the container at once. Among them are the processes
that would make the robot safe. Nothing can prevent that, so this module warns.
"""

from __future__ import annotations

import logging
from functools import cache
from os import getpid
from pathlib import Path

_log = logging.getLogger("strands_actors")

COMMAND = Path("/proc/1/comm")
"""File with the name of process 1."""
REMEDY = (
    "have a shell stay behind it: "
    """sh -c '"$@" & p=$!; trap "kill $p" TERM INT; wait $p; c=$?; wait $p; sleep 5; exit $c' sh python script.py"""
)
LEAVING_AT_ONCE = frozenset({"tini", "docker-init", "dumb-init", "catatonit"})
"""Init programs that end as soon as their child has ended, as with ``docker run --init``. The robot's processes
have only the moment in between to make the robot safe.
"""


@cache
def warn_once() -> None:
    """Log a warning if this process is process 1.

    Call it when a robot of real hardware is started. A simulated robot ends with its script anyway.
    """
    if getpid() == 1:
        _log.warning(
            "this script is process 1: when it ends, the kernel kills the tree with it, and nobody makes the robot "
            "safe; SIGTERM (docker stop) does not reach it. %s",
            REMEDY,
        )


def describe() -> tuple[str, str] | None:
    """Return the name of process 1, and why the robot's processes may be killed at the end of their script.

    The second text is empty if they outlive the script. The result is None if the system does not report
    process 1.
    """
    try:
        name = COMMAND.read_text().strip()
    except OSError:
        return None
    if getpid() == 1 or name.startswith("python"):
        return name, "when it ends the kernel kills a robot's tree with it, which makes the robot safe"
    if name in LEAVING_AT_ONCE:
        return name, "it ends as soon as the script does, and a robot's tree with it: only a race is won"
    return name, ""
