"""Import this, and every driver of this package is imported, with what it needs to stop its robot: a
root that is forked from one that has it does not import its own, a tenth of a second of computing.
Twins and SDKs are left out."""

from __future__ import annotations

import contextlib

from strands_actors.contract.driver import Driver
from strands_actors.contract.loading import load
from strands_actors.drivers import LEADERS, WIRES

for _where in (*WIRES.values(), *LEADERS.values()):
    _class: type[Driver] = load(_where)
    if _class.STOP_CHANNEL:
        with contextlib.suppress(ImportError):  # of an extra that is not installed: who wants this robot is told
            load(_class.STOP_CHANNEL)
