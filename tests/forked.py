"""Twins and roots that a test starts in its own process are forked, too: half a second of imports
less for a root, a whole one for a twin. Those of scripts, commands and the kill matrix are executed,
as everywhere."""

from __future__ import annotations

import os
import socket
from collections.abc import Mapping, Sequence
from typing import Any

import pytest

from strands_actors.caller.processes import tree_processes, twin_process
from strands_actors.kernel.processes.process import ChildProcess, OwnChild, specify
from strands_actors.kernel.processes.process import start as executed
from strands_actors.testing.fork_server import Forked, server, twin_server

ROOT = "strands_actors.supervisors.root.process:main"
ROOTS = (ROOT.partition(":")[0], "strands_actors.testing.every_driver")


def start(
    entry: str,
    args: Mapping[str, Any],
    pass_fds: Sequence[int] = (),
    label: str = "",
    descriptors: Sequence[int] = (),
) -> ChildProcess:
    """As ``process.start``. Its ``label`` is what it calls itself."""
    # Apart: a root that was forked beside numpy and MuJoCo would have both.
    forks = server("roots", ROOTS) if entry == ROOT else twin_server()
    ours, theirs = socket.socketpair()
    with theirs, open(os.devnull, "rb") as nothing:
        call = "strands_actors.testing.fork_server:be_child"
        pid = forks.fork(call, {}, (nothing.fileno(), 2), parent=theirs.fileno(), keep=pass_fds)
    specify(ours, entry, args, descriptors)
    return OwnChild(Forked(forks, pid), ours)


def fork_what_is_started_here() -> None:
    tree_processes.start = start
    twin_process.start = start


def execute_what_is_started_here(patch: pytest.MonkeyPatch) -> None:
    """For a test that is about fresh processes, or about whose child they are."""
    patch.setattr(tree_processes, "start", executed)
    patch.setattr(twin_process, "start", executed)
