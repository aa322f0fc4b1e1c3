"""For tests of robots, drivers and policies: a robot in memory, a tree in one process, a twin's process, the
wire's log."""

from .fake import FakeDriver, FakeHardware, Written
from .inline import InlineTree, open_inline_tree, run_virtual
from .twin import Twin
from .wirelog import Entry, WireLog

__all__ = [
    "Entry",
    "FakeDriver",
    "FakeHardware",
    "InlineTree",
    "Twin",
    "WireLog",
    "Written",
    "open_inline_tree",
    "run_virtual",
]
