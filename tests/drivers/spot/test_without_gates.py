"""Test what the robot itself does with a command that a gate of the driver refuses.

Each case takes the gate out of the driver, and sends the command to the twin. ``robot`` is the robot's own answer.
For some commands the robot has no refusal: the case says what it does instead, and why.
"""

from __future__ import annotations

import math
from collections.abc import Awaitable, Callable
from typing import Any, NamedTuple

import pytest
import trio

from strands_actors.contract.driver import Candidate, GateState
from strands_actors.contract.wire import Observation
from strands_actors.drivers.spot import driver as spot_driver
from strands_actors.drivers.spot import protocol as p
from strands_actors.drivers.spot.driver import Spot
from strands_actors.drivers.spot.messages import Message
from strands_actors.drivers.spot.robots import ARM
from strands_actors.drivers.spot.twin.feedback import INCOMPATIBLE_HARDWARE, PLANNER_MODIFIED, STALLED
from strands_actors.drivers.spot.twin.walking import REST
from strands_actors.drivers.spot.wire import SpotWire
from strands_actors.kernel.messages import Refused
from tests.drivers.common.memory_port import virtual
from tests.drivers.without_gates import checks, take_out

from .rig import PORT, Go, World, answer, let_a_tablet_have_the_e_stop, pass_time, ready

Action = dict[str, float]


class Case(NamedTuple):
    """One gate, and what happens without it."""

    gate: str
    """The gate, and any later gate that would refuse the same command."""
    action: Action
    code: str
    """The refusal of the driver with its gates."""
    robot: str
    """The robot's own answer."""
    prepare: Callable[[World, SpotWire], Awaitable[None]] | None = None
    arm: bool = True
    stands: bool = True
    target: Callable[[tuple[float, ...]], tuple[float, ...]] = lambda target: target
    age_s: float = 0.0
    """Age of the reading on which the gates judge."""
    streams: bool = False


async def press(world: World, wire: SpotWire) -> None:
    world.twin.estop.pressed = True
    world.twin.pass_time()


async def replace_the_estop(world: World, wire: SpotWire) -> None:
    let_a_tablet_have_the_e_stop(world)
    await pass_time(world, 1.2, wire)


async def steal(world: World, wire: SpotWire) -> None:
    world.twin.leases.acquire("tablet-7", take=True)


def without_el0(target: tuple[float, ...]) -> tuple[float, ...]:
    """Return a target in which one joint of the arm was never read."""
    return (*target[:5], math.nan, *target[6:])


STALE = "check_named"
"""The gate ``stale``, which checks only the joints that the action names."""
WHOLE_ARM = dict.fromkeys(ARM, 0.1)

CASES = (
    Case("_motors", {"vx": 0.3}, "motors_off", "not powered on", stands=False),
    Case("_estopped _motors", {"vx": 0.3}, "estopped", "not powered on", press),
    # Another client can set up the e-stop only while the motors are off.
    Case("_estop_of_ours _motors", {"vx": 0.3}, "estop_lost", "not powered on", replace_the_estop, stands=False),
    # The gate learns of the loss from this refusal of the robot.
    Case("_lease", {"vx": 0.3}, "lease_lost", "lease revoked", steal),
    # The API accepts the command and refuses the arm's part in its feedback.
    Case(f"_has_part {STALE}", WHOLE_ARM, "no_arm", "incompatible hardware", arm=False),
    Case("_whole_arm", {"arm_sh0": 0.1}, "stale", "invalid request", target=without_el0),
    # No refusal: the robot does not know how old the driver's reading is.
    Case(STALE, {"arm_sh0": 0.3}, "stale", "moves with 2.5 rad/s", age_s=1.0),
    # No refusal: the API has no status for a speed that is too high. The robot walks as fast as it can.
    Case("past_range", {"vx": 3.0}, "past_travel", "walks with 1.6 m/s"),
    # The robot moves to the nearest joint that it can reach, and never reports the move as complete.
    Case("past_range", {"arm_sh0": 3.5}, "past_travel", "stalled at the limit"),
    # No refusal: the robot limits the speed of each joint.
    Case("too_fast", {"arm_sh0": 1.0}, "too_fast", "moves with 2.5 rad/s", streams=True),
)


def judged(driver: Spot, action: Action, seen: Observation, case: Case) -> Candidate | Refused:
    target = case.target(tuple(0.0 if value != value else value for value in seen.position))
    now_ns = seen.t_ns + round(case.age_s * 1e9)
    state = GateState(now_ns, seen, target, now_ns, case.streams, 0.1 if case.streams else 0.0)
    return answer(action, state, driver)


@pytest.mark.parametrize("case", CASES, ids=lambda case: f"{case.gate} {next(iter(case.action))}")
def test_the_robot_answers_what_a_gate_no_longer_refuses(case: Case, monkeypatch: pytest.MonkeyPatch) -> None:
    async def test() -> None:
        world = World(arm=case.arm)
        wire = await ready(world, case.stands)
        if case.prepare is not None:
            await case.prepare(world, wire)
        seen = await wire.read()
        if case.robot != "lease revoked":
            refusal = judged(world.driver, case.action, seen, case)
            assert isinstance(refusal, Refused) and refusal.code == case.code
        driver = Spot("spot", PORT, Spot.resolve("spot", {}))
        take_out(driver, case.gate.split(), monkeypatch)
        candidate = judged(driver, case.action, seen, case)
        assert isinstance(candidate, Candidate), candidate
        sent = len(world.of("RobotCommand"))
        await wire.write(candidate.values, Go())
        assert len(world.of("RobotCommand")) == sent + 1, "the robot has judged the command"
        assert await what_the_robot_did(world, wire) == case.robot
        if case.robot == "lease revoked":
            refusal = judged(world.driver, case.action, await wire.read(), case)
            assert isinstance(refusal, Refused) and refusal.code == case.code

    virtual(test)


async def what_the_robot_did(world: World, wire: SpotWire) -> str:
    """Return the robot's refusal of the last command; what it does if it has accepted the command."""
    seen, mechanism = await wire.read(), world.twin.mechanism
    if "lease" in seen.faults:
        assert seen.faults["lease"] == "the lease was taken over by tablet-7"
        assert not mechanism.walks
        return "lease revoked"
    if "command" in seen.faults:
        assert not mechanism.walks and mechanism.arm_arrived, "a refused command moves nothing"
        return seen.faults["command"].removeprefix("the last command was refused: ")
    walked, turned, arm = 0.0, 0.0, Message()
    for _ in range(150):
        await trio.sleep(0.02)
        world.twin.pass_time()
        walked, turned = max(walked, mechanism.present_twist[0]), max(turned, abs(mechanism.speeds[0]))
        feedback = world.twin.commands.feedback(wire._command_id).get("synchronized_feedback", {})
        arm = feedback.get("arm_command_feedback", {})
    if not arm:
        return f"walks with {walked:.1f} m/s"
    if arm["status"] == INCOMPATIBLE_HARDWARE:
        assert "arm_joint_move_feedback" not in arm
        return "incompatible hardware"
    if arm["arm_joint_move_feedback"]["status"] == STALLED:
        assert arm["arm_joint_move_feedback"]["planner_status"] == PLANNER_MODIFIED
        assert mechanism.joints[0] == pytest.approx(3.14159)
        return "stalled at the limit"
    return f"moves with {turned:.1f} rad/s"


def test_every_gate_has_a_case() -> None:
    names = {name for case in CASES for name in case.gate.split()}
    assert set(checks(Spot("spot", PORT, {}))) == names


# -- what the driver adds to a command, and its services


@pytest.mark.parametrize(("twist_s", "status"), [(700.0, "too distant"), (-0.1, "expired")])
def test_a_twist_without_its_end_is_refused_by_the_robot(
    twist_s: float, status: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def test() -> None:
        world = World()
        wire = await ready(world)
        monkeypatch.setattr(p, "TWIST_S", twist_s)
        refusal = await wire.perform("set_twist", {"vx": 0.3}, Go())
        assert isinstance(refusal, Refused) and status in refusal.text
        assert not world.twin.mechanism.walks

    virtual(test)


@pytest.mark.parametrize(("speed", "status"), [(math.nan, "invalid request"), (math.inf, "invalid request")])
def test_a_twist_that_is_no_number_is_refused_by_the_robot(speed: float, status: str) -> None:
    """``refuse_twist`` refuses it first. The wire has no gate of its own."""

    async def test() -> None:
        world = World()
        assert world.driver.check_service("set_twist", {"vx": speed}) is not None
        refusal = await (await ready(world)).perform("set_twist", {"vx": speed}, Go())
        assert isinstance(refusal, Refused) and status in refusal.text
        assert world.twin.mechanism.target_twist == REST

    virtual(test)


def test_a_twist_past_its_limit_is_limited_by_the_robot() -> None:
    """The API has no status for a speed that is too high (see ``walking.py``)."""

    async def test() -> None:
        world = World()
        assert world.driver.check_service("set_twist", {"vx": 9.0, "wz": -9.0}) is not None
        answered = await (await ready(world)).perform("set_twist", {"vx": 9.0, "wz": -9.0}, Go())
        assert not isinstance(answered, Refused)
        assert world.twin.mechanism.target_twist == (1.6, 0.0, -1.5)

    virtual(test)


def test_no_command_of_the_robot_moves_a_leg(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without ``refuse_leg`` no action names a leg, because a leg is no axis. The API's only command to a leg is
    the joint control, which is not modelled."""
    monkeypatch.setattr(spot_driver, "refuse_leg", lambda action: None)
    refusal = answer({"fl_hx": 0.1})
    assert isinstance(refusal, Refused) and refusal.code == "unknown_joint"

    async def test() -> None:
        world = World()
        wire = await ready(world)
        command: Message = {"full_body_command": {"joint_request": {}}}
        before = world.twin.mechanism.legs_rad
        assert await wire._command(command, Go()) == p.Command.UNSUPPORTED
        await trio.sleep(0.5)
        assert world.twin.mechanism.legs_rad == before

    virtual(test)


def test_a_wrong_clock_is_refused_by_the_robot() -> None:
    """The driver does not connect without the robot's clock, and leaves the robot when the robot refuses it."""

    async def test() -> None:
        world = World()
        wire = await ready(world)
        clock = "the clock before"
        body: dict[str, Any] = {"lease": wire._lease.use(), "clock_identifier": clock}
        body["command"] = p.together(p.twist((0.3, 0.0, 0.0), wire._time.in_ns(0.6)))
        answered = await wire.session.answer(wire.session.ask("RobotCommand", body, Go()))
        assert answered["status"] == p.Command.NO_TIMESYNC and not world.twin.mechanism.walks

    virtual(test)
