"""For tests of robots, drivers and policies. docs/testing.md shows each with an example.

``conformance``, ``check_driver``       what every driver must keep
``Faults``, ``Victims``, ``run_cell``   break one process of a moving robot, and read the wire
``Twin``, ``WireLog``                   a robot without the robot, and what was on its wire
``run_virtual``, ``open_inline_tree``   a whole tree in one process, in virtual time
``FakeDriver``, ``FakeHardware``        a robot in memory

The pytest plugin (``strands_actors.pytest_plugin``) has the fixtures ``strands_twin`` and
``strands_robot``.
"""

from .bench import Bench, NotMoving
from .cells import Outcome, run_cell
from .conformance import Check, Result, check_driver, conformance
from .fake import FakeDriver, FakeHardware, Written
from .faults import Cell, Faults, Victims, cells_of
from .inline import InlineTree, open_inline_tree, run_virtual
from .twin import Twin
from .wirelog import Entry, WireLog

__all__ = [
    "Bench",
    "Cell",
    "Check",
    "Entry",
    "FakeDriver",
    "FakeHardware",
    "Faults",
    "InlineTree",
    "NotMoving",
    "Outcome",
    "Result",
    "Twin",
    "Victims",
    "WireLog",
    "Written",
    "cells_of",
    "check_driver",
    "conformance",
    "open_inline_tree",
    "run_cell",
    "run_virtual",
]
