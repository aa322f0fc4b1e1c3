"""Test what confirms a hold: measured positions that stand still.

If the arm follows our answers, the controller must also report that it has taken a holding one. The controller
is in memory, in virtual time.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, cast

import pytest
import trio
from msgspec.structs import replace

from strands_actors.contract.wire import MotorReport
from strands_actors.drivers.common.ports.udp_port import UdpListener
from strands_actors.drivers.kuka.link import ALONE_STAND_S, Link, answer_instead, first_message
from strands_actors.drivers.kuka.protocol import (
    COUNTER,
    JOINTS,
    Drive,
    Monitoring,
    State,
    decode_command,
    encode_monitoring,
    has_reached,
)
from strands_actors.drivers.kuka.robots import arm_of
from strands_actors.drivers.kuka.session import RUN
from strands_actors.kernel.clock import VirtualClock
from tests.drivers.common.memory_port import virtual

from .rig import all_safe

ARM = arm_of("kuka_iiwa")
CYCLE_S = 0.005
HERE = (0.3,) * JOINTS
ON, OFF = (int(Drive.ACTIVE),) * JOINTS, (int(Drive.OFF),) * JOINTS
Path = Callable[[float], float]


class Controller:
    """A port with a controller at its other end. ``path`` is the offset of joint2 over time in seconds."""

    def __init__(self, path: Path = lambda t_s: 0.0, *, arrives: bool = True, **said: Any) -> None:
        self.path = path
        self.arrives = arrives  # True if our answers arrive
        self.heard: list[int] = []  # numbers of the answers that arrived
        facts = {"state": State.COMMANDING_ACTIVE, "drives": ON, "quality": 3, "reflected": 7, **said}
        self.said = Monitoring(0, commanded=HERE, interpolated=HERE, sample_ms=5, client_mode=1, **facts)

    async def read(self) -> bytes:
        await trio.sleep(CYCLE_S)
        off = self.path(trio.current_time())
        position = (HERE[0], HERE[1] + off, *HERE[2:])
        self.said = replace(self.said, sequence=self.said.sequence + 1, position=position)
        return encode_monitoring(self.said)

    def read_waiting(self) -> None:
        return None

    def write(self, data: bytes) -> None:
        if self.arrives:
            self.heard.append(decode_command(data).sequence)
            self.said = replace(self.said, reflected=self.heard[-1])

    async def meet(self, is_controller: Callable[[bytes], bool]) -> None:
        while not is_controller(await self.read()):
            pass


def port(controller: Controller) -> UdpListener:
    return cast("UdpListener", controller)


def held_by_the_root(controller: Controller) -> tuple[MotorReport, ...]:
    """Stop as the stop channel does, and return the reports."""
    reported: list[tuple[MotorReport, ...] | None] = []

    async def test() -> None:
        reported.append(await answer_instead(port(controller), ARM, VirtualClock(), 0.0, ""))

    virtual(test)
    assert reported[0] is not None
    return reported[0]


def test_saf_005_an_arm_at_rest_with_an_acknowledging_controller_is_held() -> None:
    reports = held_by_the_root(Controller())
    assert all_safe(reports) and reports[0].acknowledged and reports[0].target == HERE[0]


def test_saf_005_answers_without_acknowledgement_confirm_no_hold() -> None:
    """The link is cut in one direction: the controller sends, but receives no answer."""
    reports = held_by_the_root(Controller(arrives=False))
    assert not any(report.safe or report.acknowledged for report in reports)
    assert reports[0].written and reports[0].detail == "the controller has acknowledged no answer since the stop"


@pytest.mark.parametrize("takes", [False, True])
def test_saf_005_a_setpoint_that_was_taken_is_no_hold(takes: bool) -> None:
    """As long as the holds are lost, the controller reflects the number of an answer from before the stop."""

    async def test() -> None:
        controller, clock = Controller(), VirtualClock()
        link = Link(port(controller), ARM, clock, await first_message(port(controller)))

        async def cycle() -> None:
            link.answer(await link.receive())

        link.session.aim((0.31, *HERE[1:]), 0.05)
        for _ in range(5):
            await cycle()
        link.session.hold()
        controller.arrives = takes
        before = controller.said.reflected
        reports = await link.bring_to_stand(cycle, "")
        assert all_safe(reports) is reports[0].acknowledged is takes
        assert before == 7 + 5, "the reflected answer is the last setpoint"

    virtual(test)


MOVES = {
    "turns": lambda t_s: 1.4 * t_s,
    "falls": lambda t_s: -2.5 * t_s**2,
    "begins to slip": lambda t_s: -0.5 * t_s**2,
}


@pytest.mark.parametrize("path", MOVES.values(), ids=MOVES)
@pytest.mark.parametrize(
    "said",
    [
        {"state": State.MONITORING_READY},
        {"state": State.MONITORING_WAIT, "safety": 3, "drives": OFF},
        {"state": State.COMMANDING_WAIT},
        {"state": State.IDLE},
    ],
    ids=str,
)
def test_saf_005_a_session_that_does_not_command_does_not_prove_a_standstill(
    path: Path, said: dict[str, Any]
) -> None:
    """The motion of a robot in its own stop is unknown. A joint without power may fall."""
    reports = held_by_the_root(Controller(path, **said))
    assert not any(report.safe for report in reports)
    assert reports[0].written and reports[0].acknowledged, "the controller acknowledges the answers"
    assert reports[0].detail.endswith("the arm still moves")


@pytest.mark.parametrize(
    ("said", "detail"),
    [
        ({}, "FRI session is MONITORING_READY: the robot's own program holds it"),
        ({"safety": 3}, "FRI session is MONITORING_READY: the arm stands still, stopped by the robot itself"),
        ({"drives": OFF}, "FRI session is MONITORING_READY: the arm stands still, stopped by the robot itself"),
    ],
)
def test_a_session_that_only_monitors_is_held_once_it_is_seen_to_stand(said: dict[str, Any], detail: str) -> None:
    def path(t_s: float) -> float:
        return min(t_s, 0.2)

    controller = Controller(path, state=State.MONITORING_READY, **said)
    reports = held_by_the_root(controller)
    assert all_safe(reports) and reports[0].detail == detail
    assert controller.said.sequence * CYCLE_S >= 0.2 + 0.9 * ALONE_STAND_S


def test_a_controller_that_names_no_answer_while_it_monitors_is_not_called_acknowledged() -> None:
    """It is unknown whether a controller does so. The measurement still shows that the arm stands."""
    reports = held_by_the_root(Controller(arrives=False, state=State.MONITORING_READY))
    assert all_safe(reports) and not reports[0].acknowledged


def test_numbers_that_wrap_are_compared_as_such() -> None:
    assert has_reached(5, 5) and has_reached(0, COUNTER) and has_reached(3, COUNTER - 3)
    assert not has_reached(4, 5) and not has_reached(COUNTER, 0)


def test_saf_022_a_session_that_is_commanded_is_joined_when_its_numbers_go_on() -> None:
    """One message is not enough. It may be an old one, with a position from which the arm would jump."""

    async def test() -> None:
        controller = Controller()
        read = controller.read
        old = await read()
        replayed = [old, old, old, old]

        async def replaying() -> bytes:
            return replayed.pop() if replayed else await read()

        controller.read = replaying  # type: ignore[method-assign]
        said = await first_message(port(controller))
        assert said.sequence == 1 + RUN - 1 and not replayed

    virtual(test)
