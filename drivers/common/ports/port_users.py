"""Find which other programs have a device open. Two programs on one bus garble each other's replies."""

from __future__ import annotations

import os
import stat
from collections.abc import Iterator
from pathlib import Path

PROC = Path("/proc")
_SHOWN = 60
_BEGINS, _NAMED = "strands_actors.kernel", "strands-actors "
"""Marks of a tree's processes: a part of their command line, and its beginning once they have their
names. The program is the process that started them."""


def users_of(path: str) -> tuple[str, ...]:
    """Return the other programs that have the device open, such as ``python arm.py (process 4242)``.

    The result is empty if there is no such program, or if the system does not show it. Linux shows only the user's
    own processes; other systems show no processes.
    """
    try:
        device = os.stat(path).st_rdev
    except OSError:
        return ()
    # The parent process supervises this one, and has a duplicate of the device's descriptor.
    own = {os.getpid(), os.getppid()}
    programs = {_program(pid) for pid in _processes() if pid not in own and _has_open(pid, device)}
    return tuple(f"{_command(pid)} (process {pid})" for pid in sorted(programs - own))


def _processes() -> Iterator[int]:
    if PROC.is_dir():
        yield from (int(entry.name) for entry in PROC.iterdir() if entry.name.isdecimal())


def _has_open(pid: int, device: int) -> bool:
    """Return True if a process has the device open. A process that simulates the device does not count. It has the
    master end of the pseudo-terminal open, and may also keep the device open."""
    is_open = False
    try:
        for entry in (PROC / str(pid) / "fd").iterdir():
            info = entry.stat()
            is_open |= stat.S_ISCHR(info.st_mode) and info.st_rdev == device
            if str(entry.readlink()).endswith("ptmx") and _terminal(pid, entry.name) == os.minor(device):
                return False
    except OSError:
        return False  # The process has ended, or may not be inspected.
    return is_open


def _terminal(pid: int, descriptor: str) -> int | None:
    """Return the number of the pseudo-terminal of which this descriptor is the master end. Source:
    proc_pid_fdinfo(5)."""
    for line in (PROC / str(pid) / "fdinfo" / descriptor).read_text().splitlines():
        name, _, value = line.partition(":")
        if name == "tty-index":
            return int(value)
    return None


def _program(pid: int) -> int:
    """If a process belongs to this project, return the process id of the program that started it; otherwise return
    ``pid``."""
    while _is_ours(_command_line(pid)):
        parent = _parent(pid)
        if parent <= 1:
            break
        pid = parent
    return pid


def _is_ours(command_line: str) -> bool:
    return _BEGINS in command_line or command_line.startswith(_NAMED)


def _parent(pid: int) -> int:
    try:
        return int((PROC / str(pid) / "stat").read_text().rpartition(")")[2].split()[1])
    except OSError:
        return 0


def _command_line(pid: int) -> str:
    try:
        return (PROC / str(pid) / "cmdline").read_bytes().replace(b"\0", b" ").decode("utf-8", "replace").strip()
    except OSError:
        return ""


def _command(pid: int) -> str:
    words = "".join(char if char.isprintable() else " " for char in _command_line(pid)) or "a program"
    return words if len(words) <= _SHOWN else f"{words[: _SHOWN - 3]}..."
