"""A policy that writes to a file what its process can access, and then does not move."""

from __future__ import annotations

import gc
import json
import os
import resource
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any


class Curious:
    def __init__(self, axes: Sequence[str], into: str, secret: str, eat_mb: int = 0) -> None:
        report: dict[str, Any] = {
            "descriptors": {fd: _target(fd) for fd in os.listdir("/proc/self/fd")},
            "environment": dict(os.environ),
            "uid": os.getuid(),
            "groups": os.getgroups(),
            "memory": resource.getrlimit(resource.RLIMIT_AS)[0],
            "cpu": resource.getrlimit(resource.RLIMIT_CPU)[0],
            "processors": len(os.sched_getaffinity(0)),
            "secrets": [place for place in _dictionaries() if secret in place],
            "can_be_root": _can_be_root(),
        }
        Path(into).write_text(json.dumps(report))
        self._eaten = bytearray(eat_mb << 20)

    def step(self, observation: Mapping[str, float]) -> dict[str, float]:
        return dict(observation)


def _target(fd: str) -> str:
    try:
        return os.readlink(f"/proc/self/fd/{fd}")
    except OSError:
        return "closed"  # the descriptor of the listing itself


def _dictionaries() -> list[str]:
    """Return the contents of all dictionaries in memory, two levels deep."""
    return [
        repr({key: value for key, value in thing.items() if isinstance(value, str | dict)})
        for thing in gc.get_objects()
        if type(thing) is dict and len(thing) < 50 and "secret" not in thing
    ]


def _can_be_root() -> bool:
    try:
        os.setuid(0)
    except PermissionError:
        return False
    return True
