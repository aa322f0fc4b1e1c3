"""Import every driver of this package, with its stop channel.

A root that is forked from a process with these imports does not import its driver itself, which takes a tenth
of a second of computing. Twins and SDKs are left out.
"""

from __future__ import annotations

import contextlib

from strands_actors.contract.driver import Driver
from strands_actors.contract.loading import load
from strands_actors.drivers import LEADERS, WIRES

for _where in (*WIRES.values(), *LEADERS.values()):
    _class: type[Driver] = load(_where)
    if _class.STOP_CHANNEL:
        # The extra of this robot is not installed. Using the robot reports it.
        with contextlib.suppress(ImportError):
            load(_class.STOP_CHANNEL)
