"""Import everything that the drivers and twins of this package import.

A process that is forked from one with these imports does not load every driver to find its own, which takes a
quarter of a second of computing. Wires are left out.
"""

from __future__ import annotations

import contextlib
from importlib import import_module

from strands_actors.contract.driver import Driver
from strands_actors.contract.loading import load
from strands_actors.drivers import LEADERS, WIRES

for _where in (*WIRES.values(), *LEADERS.values()):
    _class: type[Driver] = load(_where)
    # The extra of this twin is not installed. Starting the twin reports it.
    with contextlib.suppress(ImportError):
        import_module(_class.TWIN.partition(":")[0])
