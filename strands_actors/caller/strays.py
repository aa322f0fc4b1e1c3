"""Trees that nobody can ask: their note or their sockets are gone, as when somebody cleared the run
directory.

A root, and whatever was forked from it, shows its directory and name in the list of processes. That
is how it is found; and it is stopped by its end, after which its wire makes the robot safe by
itself. Linux alone tells.
"""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from .run_directory import is_held, notes, run_dir

_MARK = "strands-actors:"
GONE_S = 2.0
"""Within which the wire of a root that was ended has made the robot safe, and has ended itself."""
_LOOK_S = 0.005


class Stray(NamedTuple):
    robot: str
    root: int

    @property
    def text(self) -> str:
        return f"its note in {run_dir()} is gone. its root is process {self.root}"


def label_of(robot: str) -> str:
    return f"{_MARK}{run_dir()}/{robot}"


def strays() -> list[Stray]:
    """Of the robots that meet here: roots that no note tells of, and that do not just start.
    Nobody, where that cannot be seen."""
    try:
        known = {note.robot: note.pid for note in notes()}
        labelled = dict(_labelled(label_of(""), standbys=False))
        roots = [(pid, robot) for pid, robot in labelled.items() if labelled.get(_parent(pid)) != robot]
        return sorted(
            Stray(robot, pid)
            for pid, robot in roots
            if known.get(robot, 0) != pid and (robot in known or not is_held(robot))
        )
    except OSError:  # no directory of ours, no /proc: told elsewhere
        return []


def end(stray: Stray) -> bool:
    """Kill the root. Whether all that was forked from it has ended since: its wire made the robot
    safe first."""
    try:
        fd = os.pidfd_open(stray.root)
    except ProcessLookupError:
        return _is_gone(stray)
    try:
        if stray.root in dict(_labelled(label_of(stray.robot))):  # and nobody else's number by now
            signal.pidfd_send_signal(fd, signal.SIGKILL)
    finally:
        os.close(fd)
    return _is_gone(stray)


def _is_gone(stray: Stray) -> bool:
    """Of several trees of one name, which differ in nothing else, all are waited for."""
    until_s = time.monotonic() + GONE_S
    while any(robot == stray.robot for _, robot in _labelled(label_of(stray.robot))):
        if time.monotonic() > until_s:
            return False
        time.sleep(_LOOK_S)
    return True


def _labelled(prefix: str, standbys: bool = True) -> Iterator[tuple[int, str]]:
    """(pid, robot) of this user's processes whose label begins so. ``standbys``: those too, which
    make safe when their root is gone, and must not be ended then."""
    begin = prefix.encode()
    for entry in os.scandir("/proc"):
        if not entry.name.isdigit():
            continue
        try:
            if entry.stat().st_uid != os.getuid():
                continue
            words = Path(entry.path, "cmdline").read_bytes().split(b"\0")
        except OSError:  # it has just ended
            continue
        label = next((word for word in words if word.startswith(begin)), b"")
        if label and (standbys or not words[0].endswith(b" standby")):
            yield int(entry.name), label.decode(errors="replace").rpartition("/")[2]


def _parent(pid: int) -> int:
    try:
        return int(Path(f"/proc/{pid}/stat").read_bytes().rpartition(b")")[2].split()[1])
    except OSError:
        return 0
