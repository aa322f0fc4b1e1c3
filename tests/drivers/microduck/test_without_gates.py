"""Test what the simulated robotd shows when a gate or condition of the Microduck driver is taken out."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pytest
import trio

from strands_actors.contract.driver import Driver, GateState
from strands_actors.contract.wire import Observation
from strands_actors.drivers.common.codecs.json_rpc import Call
from strands_actors.drivers.microduck import protocol as p
from strands_actors.drivers.microduck.driver import Microduck
from strands_actors.drivers.microduck.gates import HEADS, MOUTHS, MOVES, POSES
from strands_actors.drivers.microduck.robots import HEAD_AT, OPEN, POSE_AT, TWIST, modes_of
from strands_actors.drivers.microduck.twin import DuckTwin
from tests.drivers.without_gates import Row, assert_complete, judge

MODES = tuple(modes_of("microduck"))


class Bench:
    """The driver, and the simulated robotd with a duck that its policy drives, in virtual time."""

    def __init__(self) -> None:
        self.driver: Driver = Microduck("microduck", "/run/robotd.sock", {})
        self.now_s = 100.0
        self.twin = DuckTwin("microduck", lambda: self.now_s, enabled=True)
        self.hears = True  # False: the states do not arrive.
        self.run(1.0)
        assert self.seen.policy == "stand"

    def ask(self, method: str, params: Mapping[str, Any]) -> Any:
        return self.twin.answer(Call(method, dict(params), 1, False))

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds / 0.02)):
            self.now_s += 0.02
            self.twin.body.pass_time()
            if self.hears:
                self.seen, self.seen_s = p.read_state(self.twin.state()), self.now_s

    async def state(self) -> GateState:
        """Return what the wire observes: the newest state, and the answer to ``robot.policies``."""
        seen, seen_ns = self.seen, round(self.seen_s * 1e9)
        policies = p.read_policies(self.ask(p.POLICIES, {}))
        sensors = {
            "driven": (float(seen.is_driven),),
            "fallen": (float(seen.fallen),),
            "limp": (float(seen.limp),),
            "picked_up": (float(seen.picked_up),),
            "mode": (float(MODES.index(policies.mode)),),
            "sitting": (float(bool(policies.sitting)),),
        }
        row = (*seen.applied, *seen.head_rad, *(0.0,) * 5)
        observed = Observation(seen_ns, row, (seen_ns,) * len(row), sensors=sensors)
        return GateState(round(self.now_s * 1e9), observed, (0.0,) * len(row), seen_ns, False)

    async def send(self, values: tuple[float, ...]) -> None:
        """Send the intents of a target as the wire does: a twist 20 times a second, all others once."""
        if values[HEADS]:
            self.ask(p.HEAD, p.head(values[HEAD_AT]))
        if values[POSES]:
            self.ask(p.POSE, p.pose(values[POSE_AT]))
        if values[MOUTHS]:
            self.ask(p.MOUTH, {"open": values[OPEN]})
        for _ in range(40):
            self.ask(p.MOVE, p.move(*values[: len(TWIST)]) if values[MOVES] else p.REST)
            self.run(0.06)

    def fault(self) -> str:
        """Return what robotd reports of itself: its limits, and a policy that does not walk."""
        state = p.read_state(self.twin.state())
        policy = [] if state.policy in ("walk", "stand") else [state.policy]
        return ", ".join([*(limit for limit in state.limited_by if limit != "deadman"), *policy])


async def silent(bench: Bench) -> None:
    bench.hears = False
    bench.run(0.6)


async def fell(bench: Bench) -> None:
    bench.twin.body.fallen = True
    bench.run(0.1)


async def lifted(bench: Bench) -> None:
    bench.twin.body.picked_up = True
    bench.run(0.1)


async def disabled(bench: Bench) -> None:
    bench.ask(p.ENABLE, {"on": False})
    bench.run(0.1)


async def homing(bench: Bench) -> None:
    """Give the duck to its policy. It first goes to its home pose. A twist before that has no effect."""
    bench.ask(p.ENABLE, {"on": False})
    bench.ask(p.ENABLE, {"on": True})
    bench.run(0.1)


async def during_homing(bench: Bench, values: tuple[float, ...]) -> None:
    bench.ask(p.MOVE, p.move(*values[: len(TWIST)]))
    bench.run(0.1)


async def sat_down(bench: Bench) -> None:
    bench.ask(p.DO, {"skill": p.SIT_TOGGLE})
    bench.run(3.0)


WALK = {"vx": 0.2}
ROWS: tuple[Row[Bench], ...] = (
    Row("on_its_feet", WALK, "fallen", prepare=fell),
    Row("on_its_feet", WALK, no_fault="robotd only reports it: the duck walks in the air", prepare=lifted),
    Row("driven", WALK, "held", prepare=disabled),
    Row("driven", WALK, "homing", prepare=homing, send=during_homing),
    Row(
        "silent",
        WALK,
        no_fault="robotd does not know which of its states a command is based on",
        prepare=silent,
    ),
    Row("seated", WALK, "sit", prepare=sat_down),
    Row(
        "within_mode",
        {"vx": 0.5},
        no_fault="robotd limits no twist. Its policy gets one for which it was not trained",
    ),
    Row("past_range", {"head_yaw": 4.0}, "range"),
    Row("past_range", {"head_yaw": 3.0}, no_fault="robotd limits a joint to one turn: it presses against its stop"),
    Row(
        "past_range",
        {"z": 0.05},
        no_fault="robotd limits no pose. Its policy gets one for which it was not trained",
    ),
)
WALKS = ("silent", "within_mode", "lifted")
"""Rows after which the duck walks all the same."""


@pytest.mark.parametrize(
    "row", ROWS, ids=lambda row: "-".join((row.gate, row.prepare.__name__, *map(str, row.action.values())))
)
def test_robotd_shows_what_it_does_without_the_gate(row: Row[Bench], monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Bench()
    trio.run(judge, row, bench, monkeypatch)
    body = bench.twin.body
    if "vx" in row.action:
        walked = row.gate in WALKS or row.prepare.__name__ in WALKS
        assert (body.x_m > 0.3) is walked, "a duck that is not ready accepts the twist and does not walk"
    if "head_yaw" in row.action:
        assert body.head_rad[2] == 2.967, "it is at its mechanical stop"


def test_each_gate_and_condition_has_a_row() -> None:
    assert_complete(Bench().driver, ROWS)
