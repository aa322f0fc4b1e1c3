"""Find the processes of a robot that its root (the supervising process) does not supervise.

Examples are a stop process, or a program that a driver has started. They are found in the system's list of
processes, on Linux only.
"""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

import msgspec

from strands_actors.supervisors.root.messages import ProcessInfo, TreeReport

_NOT_OURS = ("caller", "host", "twin")
"""Roles of processes that are not searched for descendants. Children of the caller or the twin belong to the
user, and those of a host to its other robots.
"""
_PREFIX = "strands-"


class Entry(NamedTuple):
    """The parent and the name of one process, from the system's list of processes."""

    parent: int
    name: str


def complete(report: TreeReport, table: Mapping[int, Entry] | None = None) -> TreeReport:
    """Add to a report of a robot's processes each descendant that it does not list.

    Args:
        report: The report of the root process.
        table: The system's list of processes, by id. None reads it now.

    Returns:
        The report with these descendants. The role of an added process is ``<role of its ancestor>/<its
        name>``: a stop process of the standby is ``standby/stop``, a second one ``standby/stop/2``.
    """
    table = dict(_read_table()) if table is None else table
    roles = {process.pid: process.role for process in report.processes}
    counts: Counter[str] = Counter()
    added: list[ProcessInfo] = []
    for pid in sorted(table):
        parent = "" if pid in roles else _listed_ancestor(pid, table, roles)
        if parent and parent not in _NOT_OURS:
            role = f"{parent}/{table[pid].name}"
            counts[role] += 1
            added.append(ProcessInfo(role if counts[role] == 1 else f"{role}/{counts[role]}", pid, 0))
    return msgspec.structs.replace(report, processes=(*report.processes, *added))


def _listed_ancestor(pid: int, table: Mapping[int, Entry], roles: Mapping[int, str]) -> str:
    """Return the role (by process id in ``roles``) of a process or of its nearest ancestor with a role; empty if
    no role is found.
    """
    ancestor: int | None = pid
    while ancestor is not None and ancestor not in roles:
        ancestor = table[ancestor].parent if ancestor in table else None
    return "" if ancestor is None else roles[ancestor]


def _read_table() -> Iterator[tuple[int, Entry]]:
    """Yield every process that has not ended. Source: proc(5), /proc/pid/stat."""
    try:
        entries = os.listdir("/proc")
    except OSError:
        return
    for entry in entries:
        if entry.isdigit():
            try:
                before, _, after = Path("/proc", entry, "stat").read_bytes().rpartition(b")")
            except OSError:  # The process has just ended.
                continue
            state, parent, *_ = after.split()
            if state not in (b"Z", b"X"):
                name = before.partition(b"(")[2].decode(errors="replace")
                yield int(entry), Entry(int(parent), name.removeprefix(_PREFIX))
