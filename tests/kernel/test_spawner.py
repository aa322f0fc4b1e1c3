"""The spawner is the process that starts the others of a tree. These tests start children with it, also
when the spawner is frozen or dead.
"""

from __future__ import annotations

import os
import signal
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import pytest
import trio

from strands_actors.kernel.processes import spawner as spawner_module
from strands_actors.kernel.processes.fork import UNKNOWN, ForkedAhead
from strands_actors.kernel.processes.process import ChildProcess
from strands_actors.kernel.processes.spawner import Spawner

from . import children
from .kernel import PATIENCE_S, real_time, until

pytestmark = pytest.mark.filterwarnings("ignore:.*multi-threaded, use of fork:DeprecationWarning")
"""A root forks its spawner while it has one thread. The process that runs the tests may have more."""


@asynccontextmanager
async def spawner() -> AsyncIterator[Spawner]:
    made = Spawner()
    async with trio.open_nursery() as nursery:
        await nursery.start(made.run)
        yield made
        nursery.cancel_scope.cancel()
    await made._server.process.wait()


async def end(child: ChildProcess) -> None:
    assert await child.fence(PATIENCE_S)
    child.socket.close()


@real_time
async def test_a_child_is_started_and_gets_a_signal_and_its_exit_code_is_known() -> None:
    async with spawner() as made:
        child = await made.start(f"{children.__name__}:wait", {})
        assert child.alive
        child.kill(signal.SIGTERM)
        with trio.fail_after(PATIENCE_S):
            assert await child.wait() == -signal.SIGTERM
        assert not child.alive
        child.kill()  # harmless: it refers to the ended process, even if its number is in use again
        await end(child)


@real_time
async def test_saf_023_an_exit_code_that_is_lost_with_the_spawner_is_not_success() -> None:
    async with spawner() as made:
        child = await made.start(f"{children.__name__}:wait", {})
        os.kill(made._server.process.pid, signal.SIGKILL)
        child.kill()
        with trio.fail_after(PATIENCE_S):
            assert await child.wait() == UNKNOWN != 0
        assert not child.alive
        child.socket.close()


@real_time
async def test_a_child_has_its_own_duplicates_of_the_descriptors(tmp_path: Path) -> None:
    """So it can still write after its parent has closed the file."""
    mark = tmp_path / "written"
    async with spawner() as made:
        for text in ("first", "second"):
            with mark.open("ab") as file:
                child = await made.start(f"{children.__name__}:write", {"text": text}, descriptors=(file.fileno(),))
            with trio.fail_after(PATIENCE_S):
                assert await child.wait() == 0
            await end(child)
    assert mark.read_text() == "firstsecond"


@pytest.mark.long
@real_time
async def test_saf_010_a_frozen_spawner_starts_nothing_later(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(spawner_module, "ANSWER_S", 0.2)
    mark = tmp_path / "ran"
    async with spawner() as made:
        frozen = made._server.process.pid
        os.kill(frozen, signal.SIGSTOP)
        with pytest.raises(OSError, match="did not answer"):
            await made.start(f"{children.__name__}:touch", {"path": str(mark)})
        await until(lambda: not Path(f"/proc/{frozen}").exists())
        child = await made.start(f"{children.__name__}:wait", {})  # started by the new spawner
        assert child.alive and made._server.process.pid != frozen
        assert not mark.exists()
        await end(child)


@real_time
async def test_a_dead_spawner_is_replaced() -> None:
    async with spawner() as made:
        made._server.process.kill()
        await until(lambda: made._server.has_ended)
        child = await made.start(f"{children.__name__}:wait", {})
        assert child.alive
        await end(child)


@real_time
async def test_a_start_does_not_wait_for_a_spawner_that_dies() -> None:
    async with spawner() as made:
        os.kill(made._server.process.pid, signal.SIGSTOP)

        async def kill() -> None:
            await trio.sleep(0.05)
            made._server.process.kill()

        async with trio.open_nursery() as nursery:
            nursery.start_soon(kill)
            with trio.fail_after(PATIENCE_S), pytest.raises(OSError, match="has ended"):
                await made.start(f"{children.__name__}:wait", {})


@real_time
async def test_saf_021_a_child_that_waits_for_its_work_has_its_own_name() -> None:
    """Until a robot is connected, its standby waits for its task. A command that kills the root by name
    must not match the standby.
    """
    ahead = ForkedAhead(("so101", "standby", ""))
    assert ahead._child is not None
    command = Path(f"/proc/{ahead._child.pid}/comm")
    await until(lambda: command.read_text().strip() == "strands-standby")
    child = ahead.start(f"{children.__name__}:wait", {})
    assert child is not None
    await end(child)
