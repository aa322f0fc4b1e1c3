"""Test what the simulated controller shows when a gate of the UR driver is taken out."""

from __future__ import annotations

import math
from collections.abc import Sequence

import pytest
import trio

from strands_actors.contract.driver import Driver, GateState
from strands_actors.contract.wire import Observation
from strands_actors.drivers.ur import protocol as p
from strands_actors.drivers.ur.arms import JOINTS
from strands_actors.drivers.ur.driver import UR
from strands_actors.drivers.ur.gates import LOOKAHEAD_S
from strands_actors.drivers.ur.sdk import CONTROL_S, GAIN, UNUSED
from strands_actors.drivers.ur.twin import commands as c
from strands_actors.drivers.ur.twin.model import HOME_RAD
from strands_actors.drivers.ur.twin.outputs import Sample
from strands_actors.drivers.ur.wire import OUTPUTS, SENSORS
from tests.drivers.ur.world import World
from tests.drivers.without_gates import Row, assert_complete, judge

ELBOW = JOINTS.index("elbow_joint")
NEAR_RAD = math.pi - 0.005
PAN_RAD = HOME_RAD[0]
LEAD_RAD = 0.95
"""A little less than the gate ``runs_ahead`` allows."""


class Bench:
    """The driver, and the simulated controller with ur-rtde's control script, in virtual time."""

    def __init__(self) -> None:
        self.driver: Driver = UR("ur5e", "192.0.2.10", {})
        self.world = World()
        self.world.start()
        self.age_s = 0.005  # Age of the newest sample that the driver has.
        self.target: tuple[float, ...] = tuple(self.world.joints)

    async def state(self) -> GateState:
        sample = Sample(self.world.controller)
        values = {name: sample[name] for name in OUTPUTS}
        now_ns = round(self.world.now_s * 1e9)
        seen_ns = now_ns - round(self.age_s * 1e9)
        sensors = {name: _row(values[output]) for name, output in SENSORS.items()}
        speed = _row(values["speed_scaling"])[0] * _row(values["target_speed_fraction"])[0]
        playing = self.world.controller.runtime_state is p.RuntimeState.PLAYING
        sensors |= {"speed_scaling": (speed,), "control": (float(playing),)}
        seen = Observation(seen_ns, _row(values["actual_q"]), (seen_ns,) * len(JOINTS), sensors=sensors)
        return GateState(now_ns, seen, self.target, now_ns, False)

    async def send(self, values: Sequence[float]) -> None:
        """Send servoJ for half a second."""
        self.servo(values, 60)

    def servo(self, values: Sequence[float], count: int = 1) -> None:
        """Send servoJ as ur-rtde does, 125 times a second."""
        for _ in range(count):
            self.world.command(c.Command.SERVO_J, *values, UNUSED, UNUSED, CONTROL_S, LOOKAHEAD_S, GAIN)
            self.world.run(CONTROL_S)

    def fault(self) -> str:
        """Return the safety mode, the state of the program, and the controller's log, unless all is normal."""
        controller = self.world.controller
        if controller.safety is p.SafetyMode.NORMAL and controller.program is not None:
            return ""
        return f"{controller.safety.name}, {controller.runtime_state.name}, {' | '.join(controller.log)}"


def _row(value: p.Value) -> tuple[float, ...]:
    return (float(value),) if isinstance(value, int | float) else tuple(map(float, value))


async def protected(bench: Bench) -> None:
    bench.world.controller.set_safety(p.SafetyMode.PROTECTIVE_STOP)


async def ended(bench: Bench) -> None:
    bench.world.controller.stop_program()


async def old(bench: Bench) -> None:
    bench.age_s = 0.5


async def slider_at_zero(bench: Bench) -> None:
    bench.world.controller.speed_slider = 0.0


async def near_the_end(bench: Bench) -> None:
    goal = list(bench.world.joints)
    goal[ELBOW] = NEAR_RAD
    bench.world.command(c.Command.MOVE_J, *goal, 3.0, 10.0)
    bench.world.run(4.0)
    assert math.isclose(bench.world.joints[ELBOW], NEAR_RAD, abs_tol=3e-3)
    bench.world.command(c.Command.NONE)
    bench.target = tuple(goal)


async def blocked(bench: Bench) -> None:
    """Let an obstacle hold the shoulder while a stream leads its target away from it, as far as the gate allows."""
    bench.world.controller.plant.set_stuck(0, True)
    for step in range(1, 51):
        bench.target = (PAN_RAD + LEAD_RAD * step / 50, *bench.target[1:])
        bench.servo(bench.target)
    assert bench.fault() == "", "the driver's gate is narrower than the controller's own limit"


async def go_on(bench: Bench, values: tuple[float, ...]) -> None:
    """Let the stream go on beyond the gate, in steps of the same size."""
    for step in range(20):
        bench.servo((values[0] + 0.02 * step, *values[1:]))


HERE = {"wrist_3_joint": 0.001}
ROWS: tuple[Row[Bench], ...] = (
    Row("modes", HERE, "PROTECTIVE_STOP, STOPPED", prepare=protected, also=("program",)),
    Row("program", HERE, "NORMAL, STOPPED", prepare=ended),
    Row(
        "stale",
        HERE,
        no_fault="the controller does not know which sample a command is based on",
        prepare=old,
    ),
    Row(
        "paused",
        HERE,
        no_fault="a speed slider at 0 is no error: the program goes on, and takes commands",
        prepare=slider_at_zero,
    ),
    Row("past_range", {"elbow_joint": NEAR_RAD + 0.01}, "a joint is to go beyond its range", prepare=near_the_end),
    Row("too_fast", {"shoulder_pan_joint": 0.5}, "C204A1, path sanity check: sudden change in target position"),
    Row(
        "runs_ahead",
        {"shoulder_pan_joint": PAN_RAD + LEAD_RAD + 0.02},
        "C153, position of shoulder_pan_joint deviates from path",
        prepare=blocked,
        send=go_on,
    ),
)


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row.gate)
def test_the_controller_shows_its_own_fault_without_the_gate(
    row: Row[Bench], monkeypatch: pytest.MonkeyPatch
) -> None:
    trio.run(judge, row, Bench(), monkeypatch)


def test_each_gate_has_a_row() -> None:
    assert_complete(Bench().driver, ROWS)
