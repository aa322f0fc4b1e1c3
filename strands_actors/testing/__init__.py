"""For tests of robots, drivers and policies: a robot in memory, a tree in one process, the wire's log."""

from .fake import FakeDriver, FakeHardware, Written
from .inline import InlineTree, open_inline_tree, run_virtual
from .wirelog import Entry, WireLog

__all__ = [
    "Entry",
    "FakeDriver",
    "FakeHardware",
    "InlineTree",
    "WireLog",
    "Written",
    "open_inline_tree",
    "run_virtual",
]
