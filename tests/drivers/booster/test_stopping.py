"""Test a hold by itself: frames, accepted answers and reports. The test defines the motion of the arms. The
tests run in virtual time, without a peer."""

from __future__ import annotations

import math
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager

import pytest
import trio

from strands_actors.contract.wire import MotorReport
from strands_actors.drivers.booster import protocol as p
from strands_actors.drivers.booster import rpc
from strands_actors.drivers.booster.config import BoosterConfig
from strands_actors.drivers.booster.gates import STATE_TTL_S
from strands_actors.drivers.booster.link import Link
from strands_actors.drivers.booster.robots import FIRST_ARM, LAST_ARM, model_of
from strands_actors.drivers.booster.rpc import Api, Mode, Response
from strands_actors.drivers.booster.stopping import AT_MOST_S, HOLD_S, TICK_S, bring_down
from strands_actors.drivers.booster.wire import SILENT_S, BoosterSession
from strands_actors.drivers.common.rtps import CDR
from strands_actors.kernel.clock import NS, VirtualClock
from strands_actors.testing import run_virtual

NOBODY = BoosterConfig(model_of("booster_t1"), "127.0.0.79")
STATE_S = 0.002
MOTORS = 23
SLOW_RAD_S = 0.29
Motion = Callable[[float], float]
"""A position as a function of the seconds since an event."""


def low_state(q: float, dq: float = 0.0, readable: bool = True) -> memoryview:
    """Encode a low state with all arm joints present. An unreadable one has a NaN torque at a leg."""
    at = range(FIRST_ARM, LAST_ARM + 1)
    rows = [tuple(value if slot in at else 0.0 for slot in range(MOTORS)) for value in (q, dq)]
    tau = (0.0,) * (MOTORS - 1) + (0.0 if readable else math.nan,)
    none = (0.0,) * 3
    return memoryview(CDR + p.encode_state(p.State(none, none, none, *rows, tau, (30,) * MOTORS)))


class Arms:
    """A robot that answers everything.

    Args:
        turns: The motion without a hold.
        held: The motion after the first frame of a hold, from the position at that time. None: the arms ignore
            the hold.
    """

    def __init__(self, link: Link, turns: Motion, held: Motion | None = None) -> None:
        self.readable = True
        self.takes_after_s = 0.0
        """The time from which the robot accepts commands."""
        self.frames: list[tuple[float, float]] = []
        """The frames that left: time, and hold position of the first arm joint."""
        self._link = link
        self._turns = turns
        self._held = held
        link.calls.ask = self._ask  # type: ignore[method-assign]
        link.commands.write = link.commands.write_stop = self._write  # type: ignore[method-assign, assignment]

    def at(self, now_s: float) -> float:
        if self._held is None or not self.frames:
            return self._turns(now_s)
        first_s = self.frames[0][0]
        return self._turns(first_s) + self._held(now_s - first_s)

    async def tell(self) -> None:
        """Send states for ever."""
        while True:
            self.say()
            await trio.sleep(STATE_S)

    def say(self) -> None:
        now_s = trio.current_time()
        speed = (self.at(now_s + 1e-4) - self.at(now_s)) / 1e-4
        self._link._on_state(low_state(self.at(now_s), speed, self.readable), b"", round(now_s * NS))

    def _ask(self, api: Api, body: str, heard: Callable[[Response], None], stop: bool = False) -> bool:
        heard(Response("", rpc.OK, rpc.change_mode(Mode.WALKING) if api is Api.GET_MODE else ""))
        return True

    def _write(self, payload: bytes) -> int:
        now_s = trio.current_time()
        if now_s < self.takes_after_s:
            return 0
        self.frames.append((now_s, p.decode_command(payload[len(CDR) :]).motors[FIRST_ARM].q))
        return 1


@asynccontextmanager
async def linked() -> AsyncIterator[Link]:
    link = Link(NOBODY, VirtualClock())
    await trio.sleep(1.0)  # at the time 0 the code would count everything as just tried
    try:
        yield link
    finally:
        link.close()


async def held(link: Link, arms: Arms) -> tuple[float, tuple[MotorReport, ...]]:
    """Hold the arms. Return how long that took, and the reports."""
    arms.say()
    began_s = trio.current_time()
    async with trio.open_nursery() as nursery:
        nursery.start_soon(arms.tell)
        reports = await bring_down(link, "hold", True)
        nursery.cancel_scope.cancel()
    return trio.current_time() - began_s, reports


def here(now_s: float) -> float:
    return 0.3


def slowly(now_s: float) -> float:
    return SLOW_RAD_S * now_s


# -- how old a state is


def test_saf_012_a_state_that_cannot_be_read_renews_no_age() -> None:
    async def test() -> None:
        session = BoosterSession(NOBODY, VirtualClock())
        arms = Arms(session.link, slowly)
        arms.say()
        known_ns, known_rad = session.link.state_ns, arms.at(trio.current_time())
        arms.readable = False
        while (now_s := trio.current_time()) * NS - known_ns <= (SILENT_S + 0.1) * NS:
            arms.say()
            assert session.link.state_ns == known_ns, "the time is that of the shown state"
            session.link.calls.last_answer_ns = round(now_s * NS)
            await trio.sleep(0.02)
        now_ns = round(trio.current_time() * NS)
        seen = session.observation()
        assert seen.t_ns == known_ns and seen.position[0] == pytest.approx(known_rad)
        assert now_ns - seen.t_ns > STATE_TTL_S * NS, "the state is old, so the gate refuses commands"
        assert session.silent_s(now_ns) > SILENT_S, "the link counts as lost"
        arms.readable = True
        arms.say()
        assert session.link.state_ns == now_ns
        session.link.close()

    run_virtual(test)


def test_saf_012_arms_are_not_held_where_they_were_when_a_state_could_be_read() -> None:
    async def test() -> None:
        async with linked() as link:
            arms = Arms(link, lambda now_s: 2.5 * now_s)
            arms.say()
            assert link.state is not None
            arms.readable = False
            for _ in range(30):
                arms.say()
                await trio.sleep(0.01)
            _, reports = await held(link, arms)
            assert arms.frames == [], "a hold at an old position would swing the arms back"
            assert not any(report.written or report.safe for report in reports)
            assert {report.detail for report in reports} == {"the position is not known"}

    run_virtual(test)


def test_saf_005_a_hold_is_not_confirmed_by_states_that_cannot_be_read() -> None:
    async def test() -> None:
        async with linked() as link:
            arms = Arms(link, here)
            arms.say()
            assert link.state is not None
            arms.readable = False
            took_s, reports = await held(link, arms)
            assert arms.frames and all(report.written and not report.safe for report in reports)
            assert took_s >= AT_MOST_S

    run_virtual(test)


# -- what counts as a hold


@pytest.mark.parametrize("held_by", [here, lambda s: 0.15 * (1 - math.exp(-s / 0.05))], ids=["rests", "hangs"])
def test_a_hold_counts_once_the_arms_rest(held_by: Motion) -> None:
    """An arm with a load sinks when it is held, and does not come back."""

    async def test() -> None:
        async with linked() as link:
            at_once = held_by is here
            arms = Arms(link, here, None if at_once else held_by)
            took_s, reports = await held(link, arms)
            assert all(report.written and report.acknowledged and report.safe for report in reports)
            assert [report.target for report in reports] == pytest.approx([0.3] * len(reports))
            assert HOLD_S <= took_s <= HOLD_S + (3 * TICK_S + STATE_S if at_once else 0.2)

    run_virtual(test)


@pytest.mark.parametrize("rad_s", [SLOW_RAD_S, -SLOW_RAD_S, 0.22, 2.0])
def test_saf_005_arms_that_turn_on_are_not_held(rad_s: float) -> None:
    """The robot's remote has taken the arms back: the robot accepts the frames without any effect."""

    async def test() -> None:
        async with linked() as link:
            arms = Arms(link, lambda now_s: rad_s * now_s)
            took_s, reports = await held(link, arms)
            assert arms.frames and all(report.written for report in reports)
            assert not any(report.acknowledged or report.safe for report in reports)
            assert {report.detail for report in reports} == {"the joint still turns"}
            assert took_s == pytest.approx(AT_MOST_S, abs=0.01)

    run_virtual(test)


def test_saf_005_a_hold_without_a_receiver_is_not_reported_as_written() -> None:
    async def test() -> None:
        async with linked() as link:
            arms = Arms(link, here)
            arms.takes_after_s = math.inf
            _, reports = await held(link, arms)
            assert not any(report.written or report.acknowledged or report.safe for report in reports)
            assert {report.detail for report in reports} == {"the robot receives no commands"}
            assert {report.target for report in reports} == {None}, "the arms keep their earlier targets"

    run_virtual(test)


def test_saf_005_a_hold_that_leaves_late_is_of_where_the_arms_are_then() -> None:
    async def test() -> None:
        async with linked() as link:
            arms = Arms(link, lambda now_s: 2.0 * now_s, lambda held_s: 0.0)
            arms.takes_after_s = trio.current_time() + 0.4
            took_s, reports = await held(link, arms)
            first_s, reported = arms.frames[0]
            assert reported == pytest.approx(2.0 * first_s, abs=2.0 * 0.01)
            assert [report.target for report in reports] == pytest.approx([reported] * len(reports))
            assert all(report.safe for report in reports)
            assert took_s >= 0.4 + HOLD_S, "the hold is sent for this long"

    run_virtual(test)
