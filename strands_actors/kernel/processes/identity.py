"""Name the processes of a robot, and let the kernel end them last when memory runs out.

``pkill python`` is meant for scripts. It must not kill the processes that make a robot safe, so they have other
names.
"""

from __future__ import annotations

import ctypes
import os
from pathlib import Path

PRODUCT = "strands"
_PR_SET_NAME = 15  # prctl(2)
# Longest name of a process in bytes (TASK_COMM_LEN without the final zero).
_COMM_BYTES = 15
# Columns of /proc/self/stat, counted after the process name: fields 48 and 49 in proc(5).
_ARG_START, _ARG_END = 45, 46
_ADJUSTMENT = Path("/proc/self/oom_score_adj")
LAST = -900
"""``oom_score_adj`` of a process that the kernel ends last, before those that it may never end. Source:
proc(5)."""


def take_name(robot: str, role: str, label: str = "") -> None:
    """Set the name of this process: ``strands-wire`` in ``ps -e`` and for ``pkill``, ``strands-actors so101
    wire`` in ``ps -f`` and ``top``.

    Nothing changes on systems that do not support it.

    Args:
        robot: The robot's name.
        role: The role of the process.
        label: A second word for ``ps -f``, by which others search for the process.
    """
    if not os.path.exists("/proc/self/stat"):
        return
    comm = f"{PRODUCT}-{role}".encode()[:_COMM_BYTES]
    ctypes.CDLL(None).prctl(_PR_SET_NAME, comm, 0, 0, 0)
    _write_arguments(b"\0".join(word.encode() for word in (f"{PRODUCT}-actors {robot} {role}", label) if word))


def _write_arguments(words: bytes) -> None:
    """Overwrite the arguments of this process in memory, which is where the kernel reads them. A longer text is
    cut."""
    fields = Path("/proc/self/stat").read_bytes().rpartition(b")")[2].split()
    start, end = int(fields[_ARG_START]), int(fields[_ARG_END])
    room = end - start
    if not start or room <= 1:
        return
    text = words[: room - 1]
    ctypes.memmove(start, text + b"\0" * (room - len(text)), room)


def lower_oom_score() -> bool:
    """Ask the kernel to end other processes first when memory runs out. Return True if the kernel accepted
    that.

    Lowering the value takes CAP_SYS_RESOURCE, unless the process was started with a value as low.
    """
    try:
        _ADJUSTMENT.write_text(f"{LAST}")
    except OSError:
        return False
    return True


def can_lower_oom_score() -> bool | None:
    """Return True if processes that this one starts may lower their OOM score (``lower_oom_score``).

    Return None where the system has no such setting.
    """
    try:
        before = _ADJUSTMENT.read_text()
    except OSError:
        return None
    may = lower_oom_score()
    if may:
        _ADJUSTMENT.write_text(before)
    return may
