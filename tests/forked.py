"""Fork the twins and roots that a test starts from its own process.

Forking saves the imports: half a second a root, one second a twin. Scripts, commands and the kill
matrix execute new processes, as outside tests.
"""

from __future__ import annotations

import os
import socket
from collections.abc import Mapping, Sequence
from typing import Any

import pytest

from strands_actors.caller.processes import tree_processes, twin_process
from strands_actors.kernel.processes.process import ChildProcess, OwnChild, specify
from strands_actors.kernel.processes.process import start as executed
from strands_actors.testing.fork_server import Forked, ForkServer, server, twin_server

ROOT = "strands_actors.supervisors.root.process:main"
ROOTS = (ROOT.partition(":")[0], "strands_actors.testing.every_driver")


def start(
    entry: str,
    args: Mapping[str, Any],
    pass_fds: Sequence[int] = (),
    label: str = "",
    descriptors: Sequence[int] = (),
) -> ChildProcess:
    """Start a process as ``process.start`` does, but forked. It does not use ``label``, because a
    process sets its name itself."""
    # Roots have a separate fork server: one that has imported numpy and MuJoCo for twins would pass both on.
    forks = root_server() if entry == ROOT else twin_server()
    ours, theirs = socket.socketpair()
    with theirs, open(os.devnull, "rb") as nothing:
        call = "strands_actors.testing.fork_server:be_child"
        pid = forks.fork(call, {}, (nothing.fileno(), 2), parent=theirs.fileno(), keep=pass_fds)
    specify(ours, entry, args, descriptors)
    return OwnChild(Forked(forks, pid), ours)


def root_server() -> ForkServer:
    return server("roots", ROOTS)


def fork_what_is_started_here() -> None:
    """Let this process fork its twins and roots. The imports of the roots' server take two seconds, so it begins
    with them now. Otherwise the first test with a robot would wait, and seem slow."""
    root_server()
    tree_processes.start = start
    twin_process.start = start


def execute_what_is_started_here(patch: pytest.MonkeyPatch) -> None:
    """Execute new processes, for a test about fresh processes or about their parents."""
    patch.setattr(tree_processes, "start", executed)
    patch.setattr(twin_process, "start", executed)
