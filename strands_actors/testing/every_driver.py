"""Import this, and everything is imported that the drivers of this package import, and their stop
channels: a root that is forked from a process that has it does not import its own. Wires are left
out: some bring an SDK, which no root has."""

from __future__ import annotations

import contextlib

from strands_actors.contract.driver import Driver
from strands_actors.contract.loading import load
from strands_actors.drivers import LEADERS, WIRES

CLASSES: tuple[type[Driver], ...] = tuple(load(where) for where in (*WIRES.values(), *LEADERS.values()))

for _class in CLASSES:
    if _class.STOP_CHANNEL:
        with contextlib.suppress(ImportError):  # of an SDK that is not installed: who wants this robot is told
            load(_class.STOP_CHANNEL)
