"""Import this, and everything is imported that the twins of this package import: a process forked
from one that has it does not load every driver to find its own, a quarter of a second of computing."""

from __future__ import annotations

from importlib import import_module

from strands_actors.contract.loading import load
from strands_actors.drivers import LEADERS, WIRES

for _where in (*WIRES.values(), *LEADERS.values()):
    import_module(load(_where).TWIN.partition(":")[0])
