"""Test what the simulated controller shows when a gate of the KUKA driver is taken out."""

from __future__ import annotations

import math
from typing import Any

import pytest
import trio

from strands_actors.contract.driver import Driver, GateState
from strands_actors.drivers.kuka.driver import Kuka
from strands_actors.drivers.kuka.protocol import (
    JOINTS,
    ClientMode,
    Command,
    ControlMode,
    Overlay,
    Quality,
    State,
    decode_command,
    encode_command,
)
from strands_actors.drivers.kuka.robots import arm_of
from strands_actors.drivers.kuka.session import FriSession
from strands_actors.drivers.kuka.twin.controller import Controller
from strands_actors.drivers.kuka.wire import observation_of
from tests.drivers.without_gates import Row, assert_complete, judge

ARM = arm_of("kuka_iiwa")
SAMPLE_S = 0.005
END_RAD = ARM.joints[5].reach_rad
NORMAL = ("good", "motion started", "mirrored")
"""Reasons of a new state of the session that are no faults."""


class Bench:
    """The driver's session, which answers the simulated controller cycle by cycle, in virtual time."""

    def __init__(self) -> None:
        self.driver: Driver = Kuka("kuka_iiwa", "", {})
        self.now_s = 1000.0
        self.notes: list[str] = []
        self.controller = Controller(
            ARM, sample_ms=round(SAMPLE_S * 1e3), now_s=lambda: self.now_s, note=self.notes.append
        )
        self.session = FriSession(ARM.speed_rad_s)
        self.hears = True  # False: the controller's messages do not arrive.
        self.message = self.controller.cycle()
        self.received_s = self.now_s
        self.cycles(160)
        assert self.controller.state is State.COMMANDING_ACTIVE, self.notes

    def cycles(self, count: int, answers: bool = True) -> None:
        for _ in range(count):
            if self.hears and self.session.accept(self.message) and answers:
                self.take(self.session.answer(self.message))
            self.now_s += SAMPLE_S
            message = self.controller.cycle()
            if self.hears:
                self.message, self.received_s = message, self.now_s

    def take(self, command: Command) -> None:
        self.controller.take_answer(decode_command(encode_command(command)))

    async def state(self) -> GateState:
        observed = observation_of(self.message, self.session.commanded, round(self.received_s * 1e9))
        return GateState(round(self.now_s * 1e9), observed, observed.sensors["commanded_rad"], 0, False)

    async def send(self, values: tuple[float, ...]) -> None:
        self.session.aim(values[:JOINTS], values[JOINTS])
        self.cycles(40)

    def fault(self) -> str:
        state, _, reason = self.notes[-1].partition(": ")
        return "" if reason in NORMAL else f"{state}: {reason}"


async def at_once(bench: Bench, values: tuple[float, ...]) -> None:
    """Send the whole step in one answer. The driver's session would divide it over the cycles of its period."""
    assert bench.session.accept(bench.message)
    bench.take(Command(bench.session.next_number(bench.message), bench.message.sequence, values[:JOINTS]))
    bench.controller.cycle()


async def silent(bench: Bench) -> None:
    bench.hears = False
    bench.cycles(60)


async def stopped(bench: Bench) -> None:
    bench.controller.safety = 1
    bench.cycles(2)


async def drive_off(bench: Bench) -> None:
    bench.controller.drives[2] = 0
    bench.cycles(2)


async def motion_ended(bench: Bench) -> None:
    bench.controller.motion = False
    bench.cycles(2)


def with_mode(name: str, number: int) -> Any:
    async def prepare(bench: Bench) -> None:
        setattr(bench.controller, name, number)
        bench.cycles(2)

    return prepare


async def poor(bench: Bench) -> None:
    """Miss some answers, but fewer than end the session."""
    bench.cycles(4, answers=False)
    bench.cycles(6)
    assert (bench.message.quality, bench.message.state) == (Quality.FAIR, State.COMMANDING_ACTIVE)


async def near_its_end(bench: Bench) -> None:
    bench.session.aim((*bench.session.commanded[:5], END_RAD - 0.02, bench.session.commanded[6]), 0.02)
    bench.cycles(600)
    bench.session.hold()
    bench.cycles(20)
    assert math.isclose(bench.message.position[5], END_RAD - 0.02, abs_tol=2e-3)


HERE = {"joint1": 0.001}
OUTSIDE = ("session", "client_mode", "overlay")
"""Conditions that refuse too while the session is not commanding."""

ROWS: tuple[Row[Bench], ...] = (
    Row("stale", HERE, "MONITORING_WAIT: no answers", prepare=silent),
    Row("safety", HERE, "safety stop", prepare=stopped, also=OUTSIDE),
    Row("drives", HERE, "a drive is off", prepare=drive_off, also=OUTSIDE),
    Row("session", HERE, "the motion was ended", prepare=motion_ended, also=("client_mode", "overlay")),
    Row(
        "client_mode",
        HERE,
        no_fault="FRI answers no command. Positions that the program does not ask for move nothing",
        prepare=with_mode("client_mode", ClientMode.TORQUE),
    ),
    Row(
        "control_mode",
        HERE,
        no_fault="the controller takes positions in impedance control as well: the arm only gives way",
        prepare=with_mode("control_mode", ControlMode.JOINT_IMPEDANCE),
    ),
    Row(
        "overlay",
        HERE,
        no_fault="FRI answers no command. Without an overlay nothing is added to the program's motion",
        prepare=with_mode("overlay", Overlay.NO_OVERLAY),
    ),
    Row(
        "quality",
        HERE,
        no_fault="the controller takes commands at any quality, until it ends the session",
        prepare=poor,
    ),
    Row("past_range", {"joint6": END_RAD + 0.01}, "joint6 is past its end", prepare=near_its_end),
    Row("too_fast", {"joint1": 0.3}, "joint1 steps", send=at_once),
)


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row.gate)
def test_the_controller_shows_its_own_fault_without_the_gate(
    row: Row[Bench], monkeypatch: pytest.MonkeyPatch
) -> None:
    trio.run(judge, row, Bench(), monkeypatch)


def test_each_gate_has_a_row() -> None:
    assert_complete(Bench().driver, ROWS)
