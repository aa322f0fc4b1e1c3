"""The caller's event loop, while a script or a policy computes. The questions ``stop`` and ``steady`` in
benchmarks/ measure the effect of the shorter switch interval.
"""

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


@pytest.mark.parametrize(("script_s", "expected_s"), [(0.005, SWITCH_S), (0.00005, 0.00005)])
def test_the_switch_interval_is_shortened_unless_the_script_has_a_shorter_one(
    script_s: float, expected_s: float
) -> None:
    code = (
        f"import sys; sys.setswitchinterval({script_s})\n"
        "from strands_actors.caller.session.portal import portal; portal()\n"
        "print(sys.getswitchinterval())"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True)
    assert float(done.stdout) == pytest.approx(expected_s, abs=2e-6)  # Python keeps whole microseconds


def start_and_see_it_end(*args: Any) -> process.ChildProcess:
    """Start a child, and wait for its end. The imports of a program's first robot take as long."""
    child = process.start(*args)
    while child.alive:
        time.sleep(0.001)
    return child


def test_a_root_that_ends_at_its_start_is_reported_and_ends_no_other_robot(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its socket closes before a task has begun to read it. That must not end the loop, which all robots
    of the program use.
    """
    with Robot("so101", mode="real", transport="twin") as healthy:
        with monkeypatch.context() as patch:
            patch.setattr(process, "_BOOT", "raise SystemExit(3)")
            patch.setattr(tree_processes, "start", start_and_see_it_end)
            for port in ("/dev/null/ttyACM0", "/dev/null/ttyACM1"):
                unlucky = Robot("so101", mode="real", port=port)
                problem = unlucky.connect_eagerly()
                assert problem and problem.startswith("connect: "), problem
                assert unlucky.cleanup()["status"] == "success"
        assert healthy.send_action({"gripper": 50.0})["status"] == "success"


def test_no_call_waits_for_a_loop_that_has_ended() -> None:
    portal = Portal()
    futures = []

    async def ask_while_it_ends() -> None:
        try:
            await trio.sleep_forever()
        finally:
            futures.append(portal.submit(trio.sleep_forever))

    waited = portal.submit(ask_while_it_ends)
    portal.call(trio.lowlevel.checkpoint)
    portal.leave()
    portal._thread.join(10.0)
    assert not portal._thread.is_alive()
    for future in (waited, *futures, portal.submit(trio.sleep_forever)):
        with pytest.raises(CancelledError):
            future.result(timeout=10.0)
    assert len(futures) == 1
