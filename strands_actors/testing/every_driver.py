"""Import every driver of this package, with its stop channel, but without simulated robots and SDKs.

A root process that is forked from a process with these imports need not import its driver, which takes a tenth of a
second of computing.
"""

from __future__ import annotations

import contextlib

from strands_actors.contract.driver import Driver
from strands_actors.contract.loading import load
from strands_actors.drivers import LEADERS, WIRES

for _class_path in (*WIRES.values(), *LEADERS.values()):
    _class: type[Driver] = load(_class_path)
    if _class.STOP_CHANNEL:
        # The extra package for this robot is not installed. A user of the robot gets an error that names the
        # package.
        with contextlib.suppress(ImportError):
            load(_class.STOP_CHANNEL)
