"""The caller's loop, beside a script or a policy that computes. What the shorter interval gives is
measured by the questions ``stop`` and ``steady`` in benchmarks/."""

from __future__ import annotations

import subprocess
import sys
import time
from concurrent.futures import CancelledError
from typing import Any

import pytest
import trio

from strands_actors import Robot
from strands_actors.caller.processes import tree_processes
from strands_actors.caller.session.portal import SWITCH_S, Portal
from strands_actors.kernel.processes import process


@pytest.mark.parametrize(("given_s", "found_s"), [(0.005, SWITCH_S), (0.00005, 0.00005)])
def test_a_thread_that_computes_lets_the_loop_run_soon_and_a_script_may_want_it_sooner(
    given_s: float, found_s: float
) -> None:
    code = (
        f"import sys; sys.setswitchinterval({given_s})\n"
        "from strands_actors.caller.session.portal import portal; portal()\n"
        "print(sys.getswitchinterval())"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True)
    assert float(done.stdout) == pytest.approx(found_s, abs=2e-6)  # whole microseconds


def start_and_see_it_end(*args: Any) -> process.ChildProcess:
    """As ``start``; its imports take as long as that when a program starts its first robot."""
    child = process.start(*args)
    while child.alive:
        time.sleep(0.001)
    return child


def test_a_root_that_ends_as_it_starts_is_told_and_ends_nothing_else(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its socket was closed before a task had begun to read it: that ended the loop, and with it
    every robot of the program."""
    with Robot("so101", mode="real", transport="twin") as other:
        with monkeypatch.context() as patch:
            patch.setattr(process, "_BOOT", "raise SystemExit(3)")
            patch.setattr(tree_processes, "start", start_and_see_it_end)
            for port in ("/dev/null/ttyACM0", "/dev/null/ttyACM1"):
                unlucky = Robot("so101", mode="real", port=port)
                told = unlucky.connect_eagerly()
                assert told and told.startswith("connect: "), told
                assert unlucky.cleanup()["status"] == "success"
        assert other.send_action({"gripper": 50.0})["status"] == "success"


def test_nobody_waits_for_a_loop_that_has_ended() -> None:
    portal = Portal()
    asked = []

    async def ask_while_it_ends() -> None:
        try:
            await trio.sleep_forever()
        finally:
            asked.append(portal.submit(trio.sleep_forever))

    waited = portal.submit(ask_while_it_ends)
    portal.call(trio.lowlevel.checkpoint)
    portal.leave()
    portal._thread.join(10.0)
    assert not portal._thread.is_alive()
    for future in (waited, *asked, portal.submit(trio.sleep_forever)):
        with pytest.raises(CancelledError):
            future.result(timeout=10.0)
    assert len(asked) == 1
