"""SAF-018: a tree that ends accepts no more requests and leaves no motor energised.

Processes are real, and the wire log shows the result.
"""

from __future__ import annotations

import json
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import trio

from strands_actors.caller.handle.robot import RealRobot
from strands_actors.caller.processes.nodes import open_node
from strands_actors.kernel.channels.zenoh_mesh import unix_endpoint
from strands_actors.kernel.messages import Message, Refused
from strands_actors.kernel.node import AskTimeout, Unreachable
from strands_actors.supervisors import addresses
from strands_actors.supervisors.gate.gate import Gate
from strands_actors.supervisors.gate.messages import GetStatus, Resume
from strands_actors.testing import Twin, WireLog
from strands_actors.testing.bench import Bench, Caller, moving_robot
from tests.answers import alive, until

Start = Callable[..., tuple[RealRobot, Twin]]

DELAYS_S = (0.0, 0.004, 0.008, 0.012, 0.016)
"""Times from the first limp frame of the end to a resume. At these times an earlier version accepted most
resumes.
"""


class Operator(threading.Thread):
    """Sends a resume directly to the gate, ``delay_s`` after the first safe frame since ``since_ns``."""

    def __init__(self, run_dir: Path, robot: str, log: WireLog, delay_s: float) -> None:
        super().__init__()
        self._endpoint = unix_endpoint(str(run_dir / f"{robot}.wire.sock"))
        self._robot = robot
        self._log = log
        self._delay_s = delay_s
        self.ready = threading.Event()
        self.since_ns = 2**62
        self.answer: Message | Exception | None = None
        self.start()
        assert self.ready.wait(20.0)

    def run(self) -> None:
        trio.run(self._wait_and_press)

    async def _wait_and_press(self) -> None:
        async with open_node(f"operator.{os.getpid()}", connect=[self._endpoint]) as (node, _):
            gate = node.ref(addresses.of(self._robot).gate, Gate)
            with trio.fail_after(20.0):
                while True:
                    try:
                        await gate.ask(GetStatus(), 1.0)
                        break
                    except Unreachable:
                        await trio.sleep(0.01)
            tail = self._log.tail()
            self.ready.set()
            with trio.fail_after(20.0):
                while not any(  # noqa: ASYNC110  # the wire is another process's: there is no event
                    entry.kind == "safe" and entry.t_ns >= self.since_ns for entry in tail.new()
                ):
                    await trio.sleep(0.0005)
            await trio.sleep(self._delay_s)
            try:
                self.answer = await gate.ask(Resume("an operator"), 2.0)
            except (AskTimeout, Unreachable) as failure:
                self.answer = failure


def nothing_is_energised(log: WireLog, since_ns: int) -> None:
    safe = log.first_safe(since_ns)
    assert safe is not None and safe.safe_state == "limp"
    # The absence of a frame has no event to wait for.
    time.sleep(0.5)
    log.no_setpoint_after_safe(since_ns)
    log.silent_after(safe.t_ns + 1, "enable")


@pytest.mark.parametrize("delay_s", DELAYS_S)
def test_saf_018_a_resume_during_cleanup_energises_nothing(
    strands_robot: Start, strands_run_dir: Path, delay_s: float
) -> None:
    arm, twin = strands_robot("so101")
    assert arm.send_action({"shoulder_pan": 10.0})["status"] == "success"
    operator = Operator(strands_run_dir, "so101", twin.log, delay_s)
    began_ns = operator.since_ns = time.monotonic_ns()
    assert arm.cleanup()["status"] == "success"
    operator.join()
    nothing_is_energised(twin.log, began_ns)
    assert isinstance(operator.answer, Refused | AskTimeout | Unreachable), operator.answer


@pytest.fixture(scope="module")
def bench() -> Iterator[tuple[Bench, Caller]]:
    with moving_robot("so101") as moving:
        yield moving


@pytest.mark.quick_cases(2)
@pytest.mark.parametrize("delay_s", DELAYS_S)
def test_saf_018_a_resume_at_the_death_of_the_caller_energises_nothing(
    bench: tuple[Bench, Caller], delay_s: float
) -> None:
    caller = bench[0].moving("loop")
    log, robot = bench[0].log, caller.tree["robot"]
    operator = Operator(caller.run_dir, robot, log, delay_s)
    began_ns = operator.since_ns = time.monotonic_ns()
    os.kill(caller.pid("caller"), signal.SIGKILL)
    operator.join()
    nothing_is_energised(log, began_ns)
    assert isinstance(operator.answer, Refused | AskTimeout | Unreachable), operator.answer
    bench[0].drop()


def test_saf_018_a_root_stays_for_a_motor_that_is_not_confirmed(bench: tuple[Bench, Caller]) -> None:
    """The caller is dead. The root's note names the motor, and the root ends when that motor answers."""
    caller = bench[0].moving("loop")
    pids, note = caller.pids(), caller.run_dir / f"{caller.tree['robot']}.json"
    bench[0].twin.fault("garbage:5")
    time.sleep(0.1)
    os.kill(pids["caller"], signal.SIGKILL)
    until(lambda: json.loads(note.read_bytes()).get("unconfirmed") == ["wrist_roll"], "the note names the motor")
    time.sleep(1.0)
    assert Path(f"/proc/{pids['root']}").exists(), "the root still tries to make the robot safe"
    assert not Path(f"/proc/{pids['wire']}").exists()
    healed_ns = time.monotonic_ns()
    bench[0].twin.fault("ok")
    until(lambda: not alive(pids["root"]), "the root ends")
    assert bench[0].log.first_safe(healed_ns) is not None
    assert json.loads(note.read_bytes())["unconfirmed"] == []
    bench[0].drop()


@pytest.mark.long
def test_saf_018_a_wire_without_a_root_stays_for_a_motor_that_is_not_confirmed(
    bench: tuple[Bench, Caller],
) -> None:
    """The wire process bypasses its own gate. It uses its open port first, and then opens the port again."""
    caller = bench[0].moving("loop")
    pids = caller.pids()
    bench[0].twin.fault("garbage:5")
    time.sleep(0.1)
    killed_ns = time.monotonic_ns()
    os.kill(pids["root"], signal.SIGKILL)
    until(lambda: bench[0].log.first_safe(killed_ns), "the wire makes the robot safe")
    time.sleep(5.0)
    assert alive(pids["wire"]), "the wire still tries to make the robot safe"
    healed_ns = time.monotonic_ns()
    bench[0].twin.fault("ok")
    until(lambda: not alive(pids["wire"]), "the wire ends")
    assert bench[0].log.first_safe(healed_ns) is not None
    bench[0].log.no_setpoint_after_safe(killed_ns)
    bench[0].drop()
