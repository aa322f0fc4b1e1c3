"""Test robots, drivers and policies. docs/testing.md shows each of these with an example.

``conformance``, ``check_driver``       the checks that every driver must pass
``Faults``, ``Victims``, ``run_cell``   break one process of a moving robot, and check what the robot receives
``Twin``, ``WireLog``                   a simulated robot, and the log of all frames that it exchanges
``run_virtual``, ``open_inline_tree``   all actors of a robot in one process, in virtual time
``FakeDriver``, ``FakeHardware``        a driver of a robot that exists only in memory

The pytest plugin (``strands_actors.pytest_plugin``) has the fixtures ``strands_twin`` and ``strands_robot``.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .bench import Bench, NotMoving
    from .cells import Outcome, run_cell
    from .checks import Check, Result, check_driver, conformance
    from .fake import FakeDriver, FakeHardware, Written
    from .faults import Cell, Faults, Victims, cells_of
    from .inline import InlineTree, open_inline_tree, run_virtual
    from .twin import Twin, move_by_hand
    from .wirelog import Entry, WireLog

# These modules are imported at their first use, because the processes of a bench (``testing.bench``) import this
# package and need only parts of it.
_MODULES = {
    "bench": ("Bench", "NotMoving"),
    "cells": ("Outcome", "run_cell"),
    "checks": ("Check", "Result", "check_driver", "conformance"),
    "fake": ("FakeDriver", "FakeHardware", "Written"),
    "faults": ("Cell", "Faults", "Victims", "cells_of"),
    "inline": ("InlineTree", "open_inline_tree", "run_virtual"),
    "twin": ("Twin", "move_by_hand"),
    "wirelog": ("Entry", "WireLog"),
}

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
    "move_by_hand",
    "open_inline_tree",
    "run_cell",
    "run_virtual",
]


def __getattr__(name: str) -> Any:
    for module, names in _MODULES.items():
        if name in names:
            return getattr(import_module(f"{__name__}.{module}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return list(__all__)
