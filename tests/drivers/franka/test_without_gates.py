"""Test what the simulated controller shows when a gate of the Franka driver is taken out."""

from __future__ import annotations

import pytest
import trio

from strands_actors.contract.driver import Driver, GateState
from strands_actors.contract.wire import Observation
from strands_actors.drivers.franka import cycle as cycles
from strands_actors.drivers.franka import protocol as p
from strands_actors.drivers.franka.arms import HOME_RAD, arm_of
from strands_actors.drivers.franka.cycle import Cycle, Order
from strands_actors.drivers.franka.driver import Franka
from strands_actors.drivers.franka.gates import LOST, REASONS
from strands_actors.drivers.franka.generator import Trajectory
from strands_actors.drivers.franka.twin.controller import Controller
from strands_actors.kernel.clock import NS
from strands_actors.kernel.health.heartbeat import pair
from tests.drivers.without_gates import Row, assert_complete, judge

MS_NS = 1_000_000
LONGEST_MS = 6000
"""Longest motion of these tests."""


class Bench:
    """The driver with its 1 kHz cycle, and the simulated controller, in virtual time."""

    def __init__(self, speed_factor: float = 0.2) -> None:
        franka = Franka("panda", "192.0.2.10", {"speed_factor": speed_factor})
        self.driver: Driver = franka
        arm = arm_of("panda")
        self.controller = Controller(arm, arm.fci)
        self.heartbeat, beats = pair()
        self.cycle = Cycle(self.controller.dialect, franka.limits, beats)
        self.lost = ""  # The reason for which the controller has ended an earlier motion of the driver.
        self.age_s = 0.005  # Age of the newest state that the driver has.
        self.orders = 0
        self.answer = ""  # The controller's last reply to a request for a motion.
        self.ticks(200)

    @property
    def now_ns(self) -> int:
        return NS * 1000 + self.controller.ticks * MS_NS

    def ticks(self, count: int) -> None:
        """Run the controller. The cycle answers each of its states, as its process does."""
        for _ in range(count):
            self.heartbeat.beat(self.now_ns)
            answer = self.cycle.answer(self.controller.state(), self.now_ns)
            if answer is not None:
                self.controller.take(self.controller.dialect.command(answer))
            ended = self.controller.tick()
            self.answer = self.answer if ended is None else ended[1]

    async def state(self) -> GateState:
        dialect = self.controller.dialect
        state = dialect.state(self.controller.state())
        faults = {REASONS: ", ".join(state.reasons)} if state.reasons else {}
        if self.lost:
            faults[LOST] = self.lost
        seen_ns = self.now_ns - round(self.age_s * NS)
        sensors = {"robot_mode": (float(state.robot_mode),), "success_rate": (state.success_rate,)}
        seen = Observation(seen_ns, state.q, (seen_ns,) * 7, sensors=sensors, faults=faults)
        return GateState(self.now_ns, seen, state.q, seen_ns, False)

    async def send(self, values: tuple[float, ...]) -> None:
        """Send a target as the wire does: the order to the cycle, then the request for a motion."""
        self.orders += 1
        self.cycle.obey(Order(self.orders, values).pack())
        controller = self.controller
        if controller.motion is None:
            self.answer = controller.start(1, p.Controller.JOINT_IMPEDANCE, p.Generator.JOINT_POSITION - 1)
        for _ in range(LONGEST_MS):
            self.ticks(1)
            if controller.motion is None:
                return

    def fault(self) -> str:
        """Return the controller's mode with its errors, and its reply, unless all is normal."""
        mode, reasons = self.controller.mode, ", ".join(sorted(self.controller.reasons))
        if mode in (p.RobotMode.IDLE, p.RobotMode.MOVE) and self.answer in ("", "motion_started", "success"):
            return ""
        return f"{self.answer}, {p.mode_name(mode)} ({reasons})"


async def stopped(bench: Bench) -> None:
    bench.controller.set_mode(p.RobotMode.USER_STOPPED)
    bench.ticks(1)


async def recovered(bench: Bench) -> None:
    """Let a reflex end a motion, and let another program clear it."""
    bench.controller.start(1, p.Controller.JOINT_IMPEDANCE, p.Generator.JOINT_POSITION - 1)
    bench.controller.reflex("joint_reflex")
    assert bench.controller.recover()
    bench.lost = "reflex_aborted"


async def old(bench: Bench) -> None:
    bench.age_s = 0.5


async def few_commands(bench: Bench) -> None:
    """Let a motion begin in which only each third command arrives."""
    controller = bench.controller
    bench.cycle.obey(Order(1, tuple(rad - 0.5 for rad in controller.q_d)).pack())
    bench.orders = 1
    assert controller.start(1, p.Controller.JOINT_IMPEDANCE, p.Generator.JOINT_POSITION - 1) == "motion_started"
    for _ in range(20):
        bench.ticks(1)
        for _ in range(2):
            controller.tick()
    assert controller.motion is not None and controller.dialect.state(controller.state()).success_rate < 0.5


HOME = dict(zip(arm_of("panda").keys, HOME_RAD, strict=True))
AHEAD = {**HOME, "joint1": HOME["joint1"] + 0.1}
FIRST = {"joint1": 0.1}

ROWS: tuple[Row[Bench], ...] = (
    Row("movable", AHEAD, "not_possible, user_stopped", prepare=stopped),
    Row(
        "not_lost",
        AHEAD,
        no_fault="the controller has recovered, and takes the next motion like any other",
        prepare=recovered,
    ),
    Row(
        "stale",
        AHEAD,
        no_fault="the controller does not know which state a target is based on: the motion begins at its own q_d",
        prepare=old,
    ),
    Row(
        "all_joints",
        FIRST,
        no_fault="a command has all seven joints. Those that are not named keep their position",
    ),
    Row(
        "past_range",
        {**HOME, "joint6": arm_of("panda").high[5] + 0.01},
        "reflex_aborted, reflex (joint_motion_generator_position_limits_violation)",
    ),
    Row(
        "reaches_it",
        AHEAD,
        no_fault="the controller goes on at any success rate, until 20 commands in a row are missing",
        prepare=few_commands,
    ),
)


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row.gate)
def test_the_controller_shows_its_own_fault_without_the_gate(
    row: Row[Bench], monkeypatch: pytest.MonkeyPatch
) -> None:
    trio.run(judge, row, Bench(), monkeypatch)


def test_each_gate_has_a_row() -> None:
    assert_complete(Bench().driver, ROWS)


# -- what the cycle keeps, in the place of a gate


class Jump(Trajectory):
    """A generator that plans nothing: the next command is the goal."""

    def step(self) -> tuple[float, ...]:
        self._position = list(self._goal)
        return tuple(self._goal)


class Hasty(Trajectory):
    """A generator without the average that limits the jerk."""

    def step(self) -> tuple[float, ...]:
        super().step()
        return tuple(self._position)


@pytest.mark.parametrize(
    ("generator", "far_rad", "reason"),
    [
        (Jump, 0.3, "joint_position_motion_generator_start_pose_invalid"),
        (Jump, 9e-4, "joint_motion_generator_velocity_discontinuity"),
        (Hasty, 0.3, "joint_motion_generator_acceleration_discontinuity"),
    ],
)
def test_a_broken_generator_shows(
    generator: type[Trajectory], far_rad: float, reason: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cycles, "Trajectory", generator)
    bench = Bench(speed_factor=1.0)
    goal = list(bench.controller.q_d)
    goal[0] += far_rad
    trio.run(bench.send, tuple(goal))
    assert bench.fault() == f"reflex_aborted, reflex ({reason})"


def test_a_cycle_that_does_not_answer_shows() -> None:
    bench = Bench()
    goal = list(bench.controller.q_d)
    goal[0] += 0.3
    bench.cycle.obey(Order(1, tuple(goal)).pack())
    bench.controller.start(1, p.Controller.JOINT_IMPEDANCE, p.Generator.JOINT_POSITION - 1)
    bench.ticks(50)
    for _ in range(p.MISSED_TICKS):
        assert bench.fault() == ""
        bench.controller.tick()
    assert bench.controller.reasons == {"communication_constraints_violation"}
