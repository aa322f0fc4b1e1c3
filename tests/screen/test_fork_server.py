"""Test that a forked process behaves like an executed one."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from strands_actors.testing.fork_server import Forked, ForkServer, twin_server

PATIENCE_S = 20.0


@pytest.fixture(scope="module")
def forks() -> Iterator[ForkServer]:
    server = ForkServer()
    yield server
    server.close()


def run(forks: ForkServer, call: str, **arguments: object) -> tuple[int, bytes | None]:
    """Return the exit code and the output on stderr."""
    output, stderr = os.pipe()
    with open(os.devnull, "rb") as nothing, open(stderr, "wb") as errors:
        pid = forks.fork(call, arguments, (nothing.fileno(), errors.fileno()))
    with open(output, "rb") as errors:
        child = Forked(forks, pid, stderr=errors)
        return child.wait(PATIENCE_S), child.communicate()[1]


def test_a_child_has_the_environment_the_directory_and_the_path_of_its_requester(
    forks: ForkServer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "of_this_test.py").write_text(
        "import os\ndef tell(to): open(to, 'w').write(f'{os.getcwd()} {os.environ[\"TOLD\"]}')\n"
    )
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("TOLD", "yes")
    monkeypatch.setattr(sys, "path", [*sys.path, str(tmp_path)])
    assert run(forks, "of_this_test:tell", to="told") == (0, b"")
    assert (tmp_path / "told").read_text() == f"{tmp_path} yes"


def test_a_failed_child_passes_on_its_error_and_its_exit_code(forks: ForkServer) -> None:
    code, output = run(forks, "no_such_module:main")
    assert code == 1 and b"No module named 'no_such_module'" in (output or b"")
    assert run(forks, "os:abort")[0] == -signal.SIGABRT
    assert run(forks, "sys:exit")[0] == 0
    assert (
        run(
            forks,
            "strands_actors.testing.twin:serve",
            driver="",
            robot="so999",
            port_file="",
            log=None,
            fault=None,
            parent_fd=None,
            control=None,
            options=[],
        )[0]
        == 2
    )


def test_a_wait_ends_in_time(forks: ForkServer) -> None:
    with open(os.devnull, "rb") as nothing:
        child = Forked(forks, forks.fork("signal:pause", {}, (nothing.fileno(), 2)))
    assert child.poll() is None
    with pytest.raises(subprocess.TimeoutExpired):
        child.wait(0.01)
    child.kill()
    assert child.wait(PATIENCE_S) == -signal.SIGKILL


def test_an_ended_fork_server_is_reported_and_replaced() -> None:
    first = twin_server()
    assert twin_server() is first
    with open(os.devnull, "rb") as nothing:
        left = Forked(first, first.fork("signal:pause", {}, (nothing.fileno(), 2)))
        first.close()
        with pytest.raises(RuntimeError, match="has ended"):
            first.fork("os:getpid", {}, (nothing.fileno(), 2))
    assert left.poll() is None, "its forked child still runs"
    left.kill()
    assert left.wait(PATIENCE_S) == -signal.SIGKILL
    assert twin_server() is not first
