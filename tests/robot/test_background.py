"""Tasks that run during a block, and a robot whose block is cancelled."""

from __future__ import annotations

import signal
import subprocess
import sys
import time

import pytest
import trio

from strands_actors.caller.processes.background import open_background
from strands_actors.testing import Twin
from tests.answers import until

from .helpers import limps

CANCELLED = """
import sys
import trio
from strands_actors import open_robot

async def main():
    with trio.CancelScope() as scope:
        async with open_robot("so101", mode="real", port=sys.argv[1]) as arm:
            answer = await arm.send_action({"shoulder_pan": 1.0})
            assert answer["status"] == "success", answer
            scope.cancel()
            await trio.sleep_forever()
    assert scope.cancelled_caught

trio.run(main)
"""


def test_a_robot_whose_block_is_cancelled_is_made_safe_and_the_program_continues(twin: Twin) -> None:
    began_ns = time.monotonic_ns()
    subprocess.run([sys.executable, "-c", CANCELLED, twin.port], check=True, timeout=60)
    assert twin.log.host("setpoint", began_ns)
    assert until(lambda: limps(twin.log, began_ns), "the arm is limp")


INTERRUPTED = """
import os, signal, sys
import trio
from strands_actors import open_robot

async def main():
    async with open_robot("so101", mode="real", port=sys.argv[1]) as arm:
        await arm.send_action({"shoulder_pan": 1.0})
        os.kill(os.getpid(), signal.SIGINT)
        await trio.sleep_forever()

signal.signal(signal.SIGINT, signal.default_int_handler)
trio.run(main)
"""


def test_a_trio_script_ends_with_ctrl_c_like_any_python_script(twin: Twin) -> None:
    began_ns = time.monotonic_ns()
    done = subprocess.run([sys.executable, "-c", INTERRUPTED, twin.port], capture_output=True, text=True)
    assert done.returncode == -signal.SIGINT
    assert done.stderr.endswith("KeyboardInterrupt\n")
    assert "Group" not in done.stderr
    assert until(lambda: limps(twin.log, began_ns), "the arm is limp")


def test_background_tasks_run_until_a_cancelled_block_has_ended() -> None:
    seen: list[str] = []

    async def answer(requests: trio.MemoryReceiveChannel[trio.Event]) -> None:
        async for request in requests:
            request.set()

    async def run() -> None:
        asks, requests = trio.open_memory_channel[trio.Event](0)
        with trio.CancelScope() as scope:
            async with open_background() as nursery:
                nursery.start_soon(answer, requests)
                try:
                    scope.cancel()
                    await trio.sleep_forever()
                finally:
                    with trio.move_on_after(10, shield=True):
                        answered = trio.Event()
                        await asks.send(answered)
                        await answered.wait()
                        seen.append("answered")
        assert scope.cancelled_caught

    trio.run(run)
    assert seen == ["answered"]


def test_a_block_that_is_cancelled_before_it_begins_is_left_at_once() -> None:
    async def run() -> None:
        with trio.CancelScope() as scope:
            scope.cancel()
            async with open_background():
                pytest.fail("the block has begun")
        assert scope.cancelled_caught

    trio.run(run)


@pytest.mark.parametrize("leave", [None, KeyError("x"), KeyboardInterrupt()])
def test_background_tasks_end_with_the_block(leave: BaseException | None) -> None:
    seen: list[str] = []

    async def beside() -> None:
        try:
            await trio.sleep_forever()
        finally:
            seen.append("ended")

    async def run() -> None:
        async with open_background() as nursery:
            nursery.start_soon(beside)
            await trio.testing.wait_all_tasks_blocked()
            if leave is not None:
                raise leave

    if leave is not None:
        with pytest.raises(type(leave)):
            trio.run(run)
    else:
        trio.run(run)
    assert seen == ["ended"]


def test_a_failing_background_task_ends_the_block() -> None:
    async def fail() -> None:
        raise OSError("broken")

    async def run() -> None:
        async with open_background() as nursery:
            nursery.start_soon(fail)
            await trio.sleep_forever()

    with pytest.raises(ExceptionGroup) as caught:
        trio.run(run)
    assert caught.group_contains(OSError, match="broken")
