"""Take out one gate of our driver, and send what it would have refused: the twin shows the robot's own fault.

The table says which fault stands behind each gate. So a gate that no longer works is seen on the twin, too.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Awaitable, Callable

import msgspec
import pytest
import trio

from strands_actors.contract.driver import Candidate, GateState
from strands_actors.drivers.xarm import gates
from strands_actors.drivers.xarm import protocol as p
from strands_actors.drivers.xarm.driver import XArm
from strands_actors.drivers.xarm.protocol import ERROR, INVALID, NOT_READY, Register, State
from strands_actors.drivers.xarm.wire import XArmWire
from strands_actors.kernel.clock import NS
from strands_actors.kernel.messages import Refused
from tests.drivers.common.memory_port import Permission

from .rig import World, armed, cycle, in_virtual_time

STEP = 0.0314
"""What the step gate allows at 100 setpoints a second, in rad."""


@dataclasses.dataclass(frozen=True)
class Behind:
    """The robot's own fault behind one gate."""

    fault: int | None
    """The error that the controller reports; None if no fault of the robot stands behind the gate."""
    narrower: str = ""
    """Why our gate refuses commands at which the robot has no fault."""


GATES = {
    "stale": Behind(None, "the controller does not know how old our reading of its arm is"),
    "past_own_range": Behind(23),
    "too_fast": Behind(
        24,
        "the threshold of error 24 is not known; the twin allows targets that arrive unevenly: 0.188 rad a step at "
        "100 Hz, where the gate allows 0.0314",
    ),
    "runs_ahead": Behind(
        31,
        "only a blocked arm has a fault; the gate also refuses targets ahead of an arm that follows slowly",
    ),
}

CONDITIONS = {
    gates.error_free: ERROR,
    gates.running: NOT_READY,
    gates.in_servo_mode: INVALID,
}
"""The flag in the reply to a command that the condition would have refused."""


def test_each_gate_and_each_condition_is_in_a_table() -> None:
    driver = XArm("xarm7", "192.0.2.1", {})
    names = {gate.__qualname__.partition(".")[0] for gate in driver.gates}
    assert names - {"outside_reported_range"} == set(GATES) - {"past_own_range"}
    assert len(driver.gates) == len(GATES)
    assert {condition.check for condition in driver.conditions} == set(CONDITIONS)
    assert all(behind.fault or behind.narrower for behind in GATES.values())


class Rig:
    """An arm that is armed, a driver with all gates, and one without the gate of the test."""

    def __init__(self, world: World, wire: XArmWire, without: XArm) -> None:
        self.world = world
        self.controller = world.controller
        self.wire = wire
        self.without = without

    async def judge(self, driver: XArm, values: tuple[float, ...], age_s: float = 0.0) -> Candidate | Refused:
        """Judge a target as the gate process does."""
        now_ns = round(trio.current_time() * NS)
        observation = await self.wire.read()
        observation = msgspec.structs.replace(observation, stamp_ns=(now_ns - round(age_s * NS),) * 7)
        state = GateState(now_ns, observation, self.wire.session.target, now_ns - NS // 100, True, 0.01)
        for condition in driver.conditions:
            if refusal := condition.check(observation, now_ns):
                return refusal
        candidate = driver.parse(dict(zip(driver.axes, values, strict=True)), state)
        for gate in driver.gates if isinstance(candidate, Candidate) else ():
            if refusal := gate(candidate, state):
                return refusal
        return candidate

    async def send(self, values: tuple[float, ...], *, age_s: float = 0.0) -> int:
        """Send a target that only the gate of the test refuses. Return the flags of the reply."""
        assert isinstance(await self.judge(self.world.driver, values, age_s), Refused), "the gate refuses it"
        assert isinstance(await self.judge(self.without, values, age_s), Candidate), "and no other gate"
        return self.write(values)

    def write(self, values: tuple[float, ...]) -> int:
        """Send a target past the wire's own limit of the range."""
        self.wire.session.target = values
        return self.controller.obey(Register.SERVO_JOINT, p.servo_data(values))[0]

    def at(self, joint: int, rad: float) -> tuple[float, ...]:
        target = self.wire.session.target
        return (*target[: joint - 1], target[joint - 1] + rad, *target[joint:])


async def rig(monkeypatch: pytest.MonkeyPatch, gate: str = "", at_rad: float | None = None) -> Rig:
    world = World()
    if at_rad is not None:
        plant = world.controller.plant
        plant.data.qpos[plant._qpos[3]] = at_rad
        world.controller.wake_up()
    wire = await armed(world)
    await cycle(wire, 10)
    with monkeypatch.context() as patch:
        if gate:
            patch.setattr(gates, gate, lambda *given: lambda candidate, state: None)
        else:
            patch.setattr(XArm, "conditions", ())
        without = XArm("xarm7", "192.0.2.1", {})
        without.conditions = XArm.conditions
    return Rig(world, wire, without)


def in_the_end(world: World, wire: XArmWire, fault: int) -> None:
    """Check the robot's behaviour after an error: it stands, and refuses all commands until it is cleared."""
    controller = world.controller
    assert (controller.error, controller.state, controller.enabled) == (fault, State.STOPPED, 0)
    here = controller.plant.position_rad
    assert controller.obey(Register.SERVO_JOINT, p.servo_data(here))[0] & (ERROR | NOT_READY) == ERROR | NOT_READY
    controller.obey(Register.SET_STATE, b"\0")
    assert controller.state == State.STOPPED, "the error must be cleared first"
    controller.obey(Register.CLEAR_ERROR, b"")
    controller.obey(Register.SET_STATE, b"\0")
    assert controller.state == State.STOPPED, "the motors must be enabled"
    controller.obey(Register.MOTION_ENABLE, b"\x08\x01")
    controller.obey(Register.SET_STATE, b"\0")
    assert controller.obey(Register.SERVO_JOINT, p.servo_data(here))[0] == 0


@in_virtual_time
async def test_saf_014_without_the_range_gate_it_is_error_23(monkeypatch: pytest.MonkeyPatch) -> None:
    arm = await rig(monkeypatch, "past_own_range", at_rad=-0.18)
    target = arm.at(4, -0.03)
    await arm.wire.write(target, Permission())
    assert arm.controller.error == 0, "the wire limits the target to the range"
    assert await arm.send(target) & ERROR
    await cycle(arm.wire, 20)
    assert arm.wire.session.control.errors[0] == GATES["past_own_range"].fault, "the driver reads it"
    in_the_end(arm.world, arm.wire, 23)


@in_virtual_time
async def test_saf_014_without_the_step_gate_it_is_error_24(monkeypatch: pytest.MonkeyPatch) -> None:
    arm = await rig(monkeypatch, "too_fast")
    for _ in range(10):
        await arm.wire.write(arm.at(1, STEP), Permission())
        await cycle(arm.wire)
    assert arm.controller.error == 0, "what the gate allows is no fault"
    # The lead gate refuses a jump of 0.2 rad in the direction of the motion, but not one against it.
    assert await arm.send(arm.at(1, -0.2)) & ERROR
    in_the_end(arm.world, arm.wire, 24)


@in_virtual_time
async def test_saf_014_a_stream_that_is_too_fast_is_error_24_by_and_by(monkeypatch: pytest.MonkeyPatch) -> None:
    arm = await rig(monkeypatch, "too_fast")
    steps = 0
    while arm.controller.error == 0 and steps < 10:
        arm.write(arm.at(1, 2 * STEP))
        await cycle(arm.wire)
        steps += 1
    assert 2 < steps < 10
    assert arm.controller.error == GATES["too_fast"].fault


@pytest.mark.parametrize("control_hz", [10, 50, 100, 250])
@in_virtual_time
async def test_the_largest_steps_that_the_gate_allows_are_no_fault(control_hz: int) -> None:
    world = World()
    wire = await armed(world)
    driver = XArm("xarm7", "192.0.2.1", {"control_frequency": control_hz})
    step = 3.14 / control_hz
    for count in range(2 * control_hz):
        target = wire.session.target
        sign = 1.0 if count < control_hz else -1.0
        await wire.write((target[0] + sign * step * 0.999, *target[1:]), Permission())
        await trio.sleep(1 / control_hz)
        await wire.read()
    assert world.controller.error == 0 and driver.timing.control_hz == control_hz


@in_virtual_time
async def test_saf_014_without_the_lead_gate_a_blocked_arm_is_error_31(monkeypatch: pytest.MonkeyPatch) -> None:
    arm = await rig(monkeypatch, "runs_ahead")
    arm.controller.jam(0, True)
    refusals = 0
    while arm.controller.error == 0 and refusals < 50:
        target = arm.at(1, STEP * 0.99)
        refusals += isinstance(await arm.judge(arm.world.driver, target), Refused)
        if arm.controller.error == 0:
            assert isinstance(await arm.judge(arm.without, target), Candidate)
            arm.write(target)
            await cycle(arm.wire)
    assert refusals, "the gate refuses before the robot has its fault"
    assert math.isclose(arm.controller.plant.position_rad[0], 0.0, abs_tol=0.02)
    in_the_end(arm.world, arm.wire, 31)


@in_virtual_time
async def test_an_old_reading_is_no_fault_of_the_robot(monkeypatch: pytest.MonkeyPatch) -> None:
    arm = await rig(monkeypatch, "stale")
    assert await arm.send(arm.at(1, STEP * 0.9), age_s=0.2) == 0
    assert GATES["stale"].fault is None


async def _error(arm: Rig) -> None:
    arm.controller.fail(31)


async def _pause(arm: Rig) -> None:
    arm.controller.set_state(State.PAUSED)


async def _stop(arm: Rig) -> None:
    arm.controller.set_state(State.STOPPED)


async def _other_mode(arm: Rig) -> None:
    arm.controller.set_mode(0)
    arm.controller.set_state(State.GO)


@pytest.mark.parametrize(
    ("condition", "cause"),
    [
        (gates.error_free, _error),
        (gates.running, _pause),
        (gates.running, _stop),
        (gates.in_servo_mode, _other_mode),
    ],
)
@in_virtual_time
async def test_without_its_conditions_the_robot_refuses_and_does_not_move(
    monkeypatch: pytest.MonkeyPatch,
    condition: Callable[..., Refused | None],
    cause: Callable[[Rig], Awaitable[None]],
) -> None:
    arm = await rig(monkeypatch)
    await cause(arm)
    await cycle(arm.wire, 20)
    here = arm.controller.plant.position_rad
    observation = await arm.wire.read()
    assert condition(observation, 0), "the condition refuses"
    assert await arm.send(arm.at(1, STEP * 0.9)) & CONDITIONS[condition]
    await cycle(arm.wire, 30)
    assert arm.controller.plant.position_rad == pytest.approx(here, abs=2e-3)
