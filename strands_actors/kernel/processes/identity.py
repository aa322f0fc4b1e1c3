"""What a process of a tree is called in lists of processes, and when the kernel may end it for want
of memory.

A name of its own: ``pkill python`` is meant for scripts, and must not reach the processes that make
a robot safe.
"""

from __future__ import annotations

import ctypes
import os
from pathlib import Path

PRODUCT = "strands"
_PR_SET_NAME = 15  # prctl(2)
_COMM_BYTES = 15  # TASK_COMM_LEN less its end
_ARG_START, _ARG_END = 45, 46  # columns of /proc/self/stat, behind the name: proc(5), fields 48 and 49
_ADJUSTMENT = Path("/proc/self/oom_score_adj")
LAST = -900
"""``oom_score_adj``: of all processes the last but those that may never be taken. Source:
proc(5)."""


def take_name(robot: str, role: str, label: str = "") -> None:
    """Be called ``strands-wire`` by ``ps -e`` and ``pkill``, ``strands-actors so101 wire`` by ``ps
    -f`` and ``top``. ``label``: a second word there, by which others look for it. Where the system
    cannot, nothing is changed."""
    if not os.path.exists("/proc/self/stat"):
        return
    comm = f"{PRODUCT}-{role}".encode()[:_COMM_BYTES]
    ctypes.CDLL(None).prctl(_PR_SET_NAME, comm, 0, 0, 0)
    _write_arguments(b"\0".join(word.encode() for word in (f"{PRODUCT}-actors {robot} {role}", label) if word))


def _write_arguments(words: bytes) -> None:
    """Over those this process was started with: that memory is what the kernel shows. Too long a
    text is cut."""
    fields = Path("/proc/self/stat").read_bytes().rpartition(b")")[2].split()
    start, end = int(fields[_ARG_START]), int(fields[_ARG_END])
    room = end - start
    if not start or room <= 1:
        return
    text = words[: room - 1]
    ctypes.memmove(start, text + b"\0" * (room - len(text)), room)


def be_taken_last() -> bool:
    """Ask the kernel to end others first when memory runs out; whether it will. Lowering takes
    CAP_SYS_RESOURCE, unless this process was started as low."""
    try:
        _ADJUSTMENT.write_text(f"{LAST}")
    except OSError:
        return False
    return True


def may_be_taken_last() -> bool | None:
    """Return whether processes that this one starts may ``be_taken_last``. None where the system
    has no such thing."""
    try:
        before = _ADJUSTMENT.read_text()
    except OSError:
        return None
    may = be_taken_last()
    if may:
        _ADJUSTMENT.write_text(before)
    return may
