"""A script that is process 1, as the command of a container is. When it ends the kernel kills every
other process of the container at once: root, wire and standby too, who would make the robot safe
after it. Nothing in the tree can help that; it can be said."""

from __future__ import annotations

import logging
from functools import cache
from os import getpid
from pathlib import Path

_log = logging.getLogger("strands_actors")

COMMAND = Path("/proc/1/comm")
"""What process 1 is called."""
REMEDY = (
    "have a shell stay behind it: "
    """sh -c '"$@" & p=$!; trap "kill $p" TERM INT; wait $p; c=$?; wait $p; sleep 5; exit $c' sh python script.py"""
)
LEAVING_AT_ONCE = frozenset({"tini", "docker-init", "dumb-init", "catatonit"})
"""Inits that end when their child does: with ``docker run --init`` the tree has the moment until
they do."""


@cache
def warn_once() -> None:
    """Call when a tree of real hardware is started. A twin ends with its script anyway."""
    if getpid() == 1:
        _log.warning(
            "this script is process 1: when it ends, the kernel kills the tree with it, and nobody makes the robot "
            "safe; SIGTERM (docker stop) does not reach it. %s",
            REMEDY,
        )


def found() -> tuple[str, str] | None:
    """Return what process 1 is, and why a tree may not outlive its script; empty: it may. None
    where the system does not tell."""
    try:
        name = COMMAND.read_text().strip()
    except OSError:
        return None
    if getpid() == 1 or name.startswith("python"):
        return name, "when it ends the kernel kills a robot's tree with it, which makes the robot safe"
    if name in LEAVING_AT_ONCE:
        return name, "it ends as soon as the script does, and a robot's tree with it: only a race is won"
    return name, ""
