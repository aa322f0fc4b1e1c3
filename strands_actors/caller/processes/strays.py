"""Find and end robots that cannot be asked, since their note or their sockets are gone.

That happens, for example, after a user cleared the run directory. A root process and its forked children show
their run directory and robot in the list of processes, so they can be found. To stop such a robot, kill its
root process. The wire process, which talks to the robot, then makes the robot safe. This works on Linux only.
"""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from .run_directory import is_running, notes, run_dir

_MARK = "strands-actors:"
GONE_S = 2.0
"""Longest time until the wire process of a killed root has made the robot safe and has ended."""
_LOOK_S = 0.005


class Stray(NamedTuple):
    robot: str
    root: int

    @property
    def text(self) -> str:
        return f"its note in {run_dir()} is gone. Its root is process {self.root}"


def label_of(robot: str) -> str:
    return f"{_MARK}{run_dir()}/{robot}"


def strays() -> list[Stray]:
    """Return the root processes of this run directory that have no note (a file on how to reach the robot) and are
    not just starting.

    The list is empty on systems that do not show the arguments of processes.
    """
    try:
        noted = {note.robot: note.pid for note in notes()}
        labelled = dict(_labelled(label_of(""), standbys=False))
        roots = [(pid, robot) for pid, robot in labelled.items() if labelled.get(_parent(pid)) != robot]
        return sorted(
            Stray(robot, pid)
            for pid, robot in roots
            if noted.get(robot, 0) != pid and (robot in noted or not is_running(robot))
        )
    except OSError:  # There is no run directory, or no /proc. Other checks report that.
        return []


def end(stray: Stray) -> bool:
    """Kill a root process. Return True if all processes that it forked have ended, too.

    The wire process makes the robot safe before it ends.
    """
    try:
        fd = os.pidfd_open(stray.root)
    except ProcessLookupError:
        return _wait_until_ended(stray)
    try:
        # The system may have given the process id to another process meanwhile, so check the label again.
        if stray.root in dict(_labelled(label_of(stray.robot))):
            signal.pidfd_send_signal(fd, signal.SIGKILL)
    finally:
        os.close(fd)
    return _wait_until_ended(stray)


def _wait_until_ended(stray: Stray) -> bool:
    """Wait until no process of a robot of this name runs.

    Several robots of one name cannot be distinguished, so it waits for all of them.
    """
    until_s = time.monotonic() + GONE_S
    while any(robot == stray.robot for _, robot in _labelled(label_of(stray.robot))):
        if time.monotonic() > until_s:
            return False
        time.sleep(_LOOK_S)
    return True


def _labelled(prefix: str, standbys: bool = True) -> Iterator[tuple[int, str]]:
    """Yield (pid, robot name) of this user's processes with a label that begins with ``prefix``. A label is a text
    in the arguments of a process (``label_of``).

    Args:
        prefix: Beginning of the labels.
        standbys: Include standby processes. A standby makes the robot safe after the end of its root, so it
            must not be killed.
    """
    begin = prefix.encode()
    for entry in os.scandir("/proc"):
        if not entry.name.isdigit():
            continue
        try:
            if entry.stat().st_uid != os.getuid():
                continue
            words = Path(entry.path, "cmdline").read_bytes().split(b"\0")
        except OSError:  # The process has just ended.
            continue
        label = next((word for word in words if word.startswith(begin)), b"")
        if label and (standbys or not words[0].endswith(b" standby")):
            yield int(entry.name), label.decode(errors="replace").rpartition("/")[2]


def _parent(pid: int) -> int:
    try:
        return int(Path(f"/proc/{pid}/stat").read_bytes().rpartition(b")")[2].split()[1])
    except OSError:
        return 0
