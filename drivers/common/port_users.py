"""Who else has a device open: two programs on one bus garble each other's answers."""

from __future__ import annotations

import os
import stat
from collections.abc import Iterator
from pathlib import Path

PROC = Path("/proc")
_SHOWN = 60
_BEGINS, _NAMED = "strands_actors.kernel", "strands-actors "
"""In the command line of a tree's own processes, and at its beginning once they have their names:
who started them is the program."""


def users_of(path: str) -> tuple[str, ...]:
    """Return the other programs that have the device open, such as ``python arm.py (process
    4242)``. Empty when there is none, and where the system does not tell (it tells of processes of
    the same user, on Linux)."""
    try:
        device = os.stat(path).st_rdev
    except OSError:
        return ()
    own = {os.getpid(), os.getppid()}  # a wire's parent is its root, which has the descriptor from it
    found = {_program(pid) for pid in _processes() if pid not in own and _has_open(pid, device)}
    return tuple(f"{_command(pid)} (process {pid})" for pid in sorted(found - own))


def _processes() -> Iterator[int]:
    if PROC.is_dir():
        yield from (int(entry.name) for entry in PROC.iterdir() if entry.name.isdecimal())


def _has_open(pid: int, device: int) -> bool:
    """Not so of who is the other end of a pseudo-terminal, and keeps this one open, too."""
    found = False
    try:
        for entry in (PROC / str(pid) / "fd").iterdir():
            info = entry.stat()
            found |= stat.S_ISCHR(info.st_mode) and info.st_rdev == device
            if str(entry.readlink()).endswith("ptmx") and _terminal(pid, entry.name) == os.minor(device):
                return False
    except OSError:
        return False  # gone meanwhile, or not ours to look at
    return found


def _terminal(pid: int, descriptor: str) -> int | None:
    """Return the number of the terminal that this is the other end of. Source:
    proc_pid_fdinfo(5)."""
    for line in (PROC / str(pid) / "fdinfo" / descriptor).read_text().splitlines():
        name, _, value = line.partition(":")
        if name == "tty-index":
            return int(value)
    return None


def _program(pid: int) -> int:
    """Return who started it, when it is a process of a tree."""
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
