"""A press of the dead-man is not lost if the gate answers late. The tests run in virtual time."""

from __future__ import annotations

import termios
from typing import Any

import pytest
import trio

from strands_actors.kernel.messages import Message
from strands_actors.kernel.node import AskTimeout, Ref
from strands_actors.supervisors.gate.messages import Acquire, Beat, GetObservation
from strands_actors.supervisors.root.messages import Operate
from strands_actors.teleoperation.actor import Teleoperation
from strands_actors.teleoperation.sources import LeaderObject
from strands_actors.testing import run_virtual
from tests.tree.writer import setpoints

from .inline import GateOfPolicy, teleoperation

PRESSED_S = 0.6


class LosesAnswers(GateOfPolicy):
    """A gate whose first ``count`` answers to one type of message are late."""

    def __init__(self, gate: Ref, kind: type[Message], count: int) -> None:
        super().__init__(gate)
        self._kind = kind
        self.left = count

    async def ask(self, message: Any, deadline_s: float) -> Message | None:
        answer = await super().ask(message, deadline_s)
        if type(message) is self._kind and self.left:
            self.left -= 1
            await trio.sleep(deadline_s)
            raise AskTimeout("lost")
        return answer


class Unplugged:
    """A third-party object with a device that is unplugged and plugged in again."""

    def __init__(self, error: Exception) -> None:
        self.error = error
        self.is_there = True
        self.made = 0

    def __call__(self) -> Unplugged:
        self.made += 1
        return self

    def connect(self) -> None:
        if not self.is_there:
            raise OSError(2, "No such file or directory: '/dev/ttyACM1'")

    def get_action(self) -> dict[str, float]:
        if not self.is_there:
            raise self.error
        return {"a.pos": 0.0, "b.pos": 0.0}

    def disconnect(self) -> None:
        if not self.is_there:
            raise self.error


class ObjectLed(Teleoperation):
    leader: Unplugged

    def _source(self) -> LeaderObject:
        return LeaderObject(self.leader, self.context.clock)


@pytest.mark.parametrize(
    "error",
    [OSError(5, "Input/output error"), ConnectionError("no status packet"), termios.error(5, "Input/output error")],
)
def test_an_object_that_is_unplugged_is_tried_again_and_takes_a_new_press(
    error: Exception, monkeypatch: pytest.MonkeyPatch
) -> None:
    leader = ObjectLed.leader = Unplugged(error)

    async def at_once(call: Any, **_: Any) -> Any:
        return call()

    monkeypatch.setattr(trio.to_thread, "run_sync", at_once)  # time in a thread is not virtual

    async def run() -> None:
        async with teleoperation(ObjectLed, {"type": "object"}, "absolute") as led, trio.open_nursery() as nursery:
            held = False

            async def operate() -> None:
                while True:
                    led.ref.tell(Operate(led.clock.now_ns(), held))
                    led.tree.gate.tell(Beat(led.actor._rollout.over))  # the caller is alive
                    await trio.sleep(0.02)

            nursery.start_soon(operate)
            await trio.sleep(0.1)
            held = True
            await trio.sleep(0.4)
            assert led.told[-1].teleop["state"] == "engaged", led.told[-1]
            leader.is_there = False
            await trio.sleep(3.5)
            assert led.told[-1].running and led.told[-1].teleop["state"] == "idle"
            assert "Error" in led.told[-1].teleop["leader"] or "error" in led.told[-1].teleop["leader"]
            assert leader.made >= 3, "the teleoperation tries again every second"
            leader.is_there = True
            await trio.sleep(1.5)
            assert led.told[-1].teleop["state"] == "idle", "the old press counts as let go"
            held = False
            await trio.sleep(0.2)
            held = True
            await trio.sleep(0.4)
            assert led.told[-1].teleop["state"] == "engaged", led.told[-1]
            nursery.cancel_scope.cancel()

    run_virtual(run)


def test_an_object_that_never_connected_ends_the_teleoperation_with_its_message(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    leader = ObjectLed.leader = Unplugged(ConnectionError())
    leader.is_there = False

    async def at_once(call: Any, **_: Any) -> Any:
        return call()

    monkeypatch.setattr(trio.to_thread, "run_sync", at_once)

    async def run() -> None:
        async with teleoperation(ObjectLed, {"type": "object"}, "absolute") as led:
            await trio.sleep(0.1)
            assert not led.told[-1].running and "/dev/ttyACM1" in led.told[-1].exit_detail

    run_virtual(run)


@pytest.mark.parametrize("kind", [Acquire, GetObservation])
def test_saf_009_a_press_with_late_answers_still_engages(kind: type[Message]) -> None:
    async def run() -> None:
        async with teleoperation(Teleoperation, {"type": "operator"}, "jog") as led:
            gate: Any = LosesAnswers(led.actor._gate, kind, 2)
            led.actor._gate = gate
            tree, clock = led.tree, led.clock
            since_ns = clock.now_ns()
            for turn in range(round(PRESSED_S / 0.02)):
                led.ref.tell(Operate(clock.now_ns(), turn > 5, {tree.driver.axes[0]: 1.0}))
                await trio.sleep(0.02)
            assert gate.left == 0 and led.told[-1].teleop["state"] == "engaged", led.told[-1]
            assert setpoints(tree, since_ns)
            led.ref.tell(Operate(clock.now_ns(), False))
            await trio.sleep(0.3)
            let_go_ns = clock.now_ns()
            await trio.sleep(0.3)
            assert setpoints(tree, let_go_ns) == [] and led.told[-1].teleop["state"] == "idle"

    run_virtual(run)
