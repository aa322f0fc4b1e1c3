"""Import this, and everything is imported that the drivers and the twins of this package import: a
process forked from one that has it does not load every driver to find its own, a quarter of a second
of computing. Wires are left out."""

from __future__ import annotations

import contextlib
from importlib import import_module

from strands_actors.contract.driver import Driver
from strands_actors.contract.loading import load
from strands_actors.drivers import LEADERS, WIRES

for _where in (*WIRES.values(), *LEADERS.values()):
    _class: type[Driver] = load(_where)
    with contextlib.suppress(ImportError):  # of an extra that is not installed: who wants this twin is told
        import_module(_class.TWIN.partition(":")[0])
