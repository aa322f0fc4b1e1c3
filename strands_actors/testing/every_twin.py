"""Import everything that the drivers and the simulated robots of this package import, but no connections to robots.

A simulated robot that is forked from a process with these imports need not search all drivers for its own, which
takes a quarter of a second of computing.
"""

from __future__ import annotations

import contextlib
from importlib import import_module

from strands_actors.contract.driver import Driver
from strands_actors.contract.loading import load
from strands_actors.drivers import LEADERS, WIRES

for _class_path in (*WIRES.values(), *LEADERS.values()):
    _class: type[Driver] = load(_class_path)
    # The extra package for this simulated robot is not installed. Starting the robot reports this.
    with contextlib.suppress(ImportError):
        import_module(_class.TWIN.partition(":")[0])
