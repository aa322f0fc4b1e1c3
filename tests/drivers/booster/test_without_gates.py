"""SAF-014: take each gate of the driver out, and look at what the robot itself does with the command.

Each row has two tests. With the gate, the command is refused and nothing is sent. Without it, the command is sent,
and the twin shows the robot's own behaviour. Many gates have no counterpart on the robot: it obeys, so that only
the gate protects it. The row then says why.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import pytest
import trio

from strands_actors.contract.driver import Candidate
from strands_actors.drivers.booster import driver as driver_module
from strands_actors.drivers.booster import gates
from strands_actors.drivers.booster import protocol as p
from strands_actors.drivers.booster import wire as wire_module
from strands_actors.drivers.booster.driver import BoosterDriver
from strands_actors.drivers.booster.protocol import Fall
from strands_actors.drivers.booster.rpc import Api, Mode, decode_request, decode_response
from strands_actors.drivers.common.kit.motor_targets import TAU
from strands_actors.kernel.messages import Refused
from strands_actors.supervisors.gate.messages import Accepted
from strands_actors.testing import run_virtual
from tests.drivers.without_gates import checks, take_out

from .memory_world import Holder, World

ELBOW, ROLL = "left_elbow_pitch", "left_shoulder_roll"
SLOTS = {ELBOW: 4, ROLL: 3}
LATER_S = 0.25
"""The twin is looked at so long after the command."""
Prepare = Callable[[World], None]
Shows = Callable[[World], None]


class Row(NamedTuple):
    """A command that one gate refuses.

    Attributes:
        gate: Name of the gate's function.
        action: The command to the arms.
        code: Code of the refusal.
        shows: Checks the twin after the command was sent without the gate.
        own: What the robot itself does: its own fault, or the reason why it has none.
        prepare: Brings the robot into the state in which the gate refuses.
        wait_s: Time until the driver knows this state.
        also: Other gates that refuse the same command, and are taken out with it.
        hands_over: True to take the upper body first.
        owns: True to take out the wire's own check too, which sends no LowCmd without the upper body.
    """

    gate: str
    action: dict[str, Any]
    code: str
    shows: Shows
    own: str
    prepare: Prepare = lambda world: None
    wait_s: float = 0.15
    also: tuple[str, ...] = ()
    hands_over: bool = True
    owns: bool = False


# -- what the twin shows


def frames(world: World) -> list[p.Command]:
    """Return the LowCmds that were sent as setpoints."""
    return [p.decode_command(entry.data) for entry in world.log.host("setpoint") if b"api_id" not in entry.data]


def obeys(world: World) -> None:
    assert frames(world) and world.onboard._command is not None and world.onboard.host_has_arms


def ignores(world: World) -> None:
    assert frames(world) and world.onboard._command is None


def not_sent(world: World) -> None:
    assert not frames(world)


def falls(world: World) -> None:
    assert frames(world) and world.onboard.body.fallen


def q(world: World, joint: str = ELBOW) -> float:
    return world.onboard.state().q[SLOTS[joint]]


def tau(world: World, joint: str = ELBOW) -> float:
    return world.onboard.state().tau[SLOTS[joint]]


def at_its_stop(world: World) -> None:
    obeys(world)
    assert q(world) < 2.27 + 0.1 and frames(world)[-1].motors[4].q == pytest.approx(3.0)
    assert world.peaks["tau"] > 5.0


def races(world: World) -> None:
    obeys(world)
    assert world.peaks["dq"] > 2.0


def saturated(world: World) -> None:
    obeys(world)
    assert frames(world)[-1].motors[4].tau == 100.0
    assert world.peaks["tau"] == pytest.approx(18.0, abs=0.1)


def takes_gains(world: World) -> None:
    obeys(world)
    assert frames(world)[-1].motors[4].kp == 500.0


def limp(world: World) -> None:
    obeys(world)
    assert tau(world, ROLL) == 0.0 and math.isnan(frames(world)[-1].motors[3].tau)


# -- what is prepared


def fallen(world: World) -> None:
    world.onboard.fall_over()


def custom(world: World) -> None:
    world.onboard.set_mode(Mode.CUSTOM)


def silent(world: World) -> None:
    world.server.send_state = lambda *_: None  # type: ignore[method-assign]


def mode_unanswered(world: World) -> None:
    """The robot is asked too often for its mode, and does not tell it."""
    world.server.order(["answer", "GET_MODE", "429"])


def fall_silent(world: World) -> None:
    due = world.server._is_due
    world.server._is_due = lambda name, *rest: name != "fall" and due(name, *rest)  # type: ignore[method-assign]


def nine_motors(world: World) -> None:
    send = world.server.send_state

    def short(writer: Any, state: bytes, now_ns: int) -> None:
        full = p.decode_state(state)
        rows = {row: getattr(full, row)[:9] for row in ("q", "dq", "tau", "temperature")}
        send(writer, p.encode_state(full._replace(**rows)), now_ns)

    world.server.send_state = short  # type: ignore[method-assign]


def not_finite(world: World) -> None:
    """Let the parser put NaN into the torque of a joint that the command does not name. No action can do this."""
    driver, parse = world.driver, world.driver.parse

    def broken(action: Any, state: Any) -> Any:
        candidate = parse(action, state)
        assert isinstance(candidate, Candidate)
        place = len(driver.axes) * TAU + driver.axes.index(ROLL)
        values = tuple(math.nan if at == place else value for at, value in enumerate(candidate.values))
        return msgspec.structs.replace(candidate, values=values)

    driver.parse = broken  # type: ignore[method-assign]


HOME = {ELBOW: {"q": 0.0}}
NO_CLOCK = "none: the robot cannot know how old the driver's knowledge of it is"

ROWS = (
    Row(
        "ready",
        HOME,
        "fallen",
        ignores,
        "it takes the arms back when it falls, and ignores LowCmd",
        fallen,
        also=("_ready_lately",),
        owns=True,
    ),
    Row(
        "mode_reported",
        HOME,
        "mode_stale",
        ignores,
        "none: it would obey. But the wire returns the upper body as soon as the mode is unknown",
        mode_unanswered,
        1.2,
        owns=True,
    ),
    Row(
        "not_custom",
        HOME,
        "custom_mode",
        falls,
        "it obeys with all motors: the legs get no torque, and it falls",
        custom,
        hands_over=False,
        owns=True,
    ),
    Row("_state_fresh", HOME, "stale", obeys, NO_CLOCK, silent),
    Row("_ready_lately", HOME, "fall_stale", obeys, NO_CLOCK, fall_silent, 1.2),
    Row(
        "_enough_motors",
        HOME,
        "too_few_motors",
        not_sent,
        "none: no T1 has fewer motors. The link has no frame for one, so nothing is sent",
        nine_motors,
        also=("finite_rows", "past_range", "steps"),
    ),
    Row(
        "_handed_over",
        HOME,
        "upper_body",
        ignores,
        "it ignores LowCmd until the upper body is handed over",
        hands_over=False,
        owns=True,
    ),
    Row("finite_rows", HOME, "not_finite", limp, "the motor gets no torque [assumed]", not_finite),
    Row(
        "past_range",
        {ELBOW: {"q": 3.0, "kp": 60.0}},
        "past_travel",
        at_its_stop,
        "none in its computer: the joint presses against its mechanical stop",
        also=("steps",),
    ),
    Row(
        "within",
        {ELBOW: {"q": 0.0, "kp": 0.0, "kd": 3.0, "dq": 30.0}},
        "too_fast",
        races,
        "none: no limit of the motor's own for a speed is known",
    ),
    Row(
        "within",
        {ELBOW: {"q": 0.0, "tau": 100.0}},
        "too_strong",
        saturated,
        "the motor gives its greatest torque, 18 Nm, and no more",
    ),
    Row(
        "gains",
        {ELBOW: {"q": 0.0, "kp": 500.0}},
        "gain",
        takes_gains,
        "none: no limit of the motor's own for a gain is known",
    ),
    Row(
        "steps",
        {ELBOW: {"q": 1.5, "kp": 60.0}},
        "too_fast",
        races,
        "none: the motor turns to a far target as fast as its torque allows",
    ),
)


def test_every_gate_has_a_row() -> None:
    assert set(checks(BoosterDriver("booster_t1", "127.0.0.77", {}))) == {row.gate for row in ROWS}
    assert all(row.own for row in ROWS)


@pytest.fixture(params=ROWS, ids=lambda row: f"{row.gate}-{row.code}")
def row(request: pytest.FixtureRequest) -> Row:
    chosen: Row = request.param
    return chosen


@pytest.fixture
def world(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> World:
    return World(tmp_path, monkeypatch)


def run(world: World, row: Row, then: Callable[[Holder], Any]) -> None:
    async def test() -> None:
        async with world.tree() as robot:
            if row.hands_over:
                await robot.do("enable_upper_body")
            row.prepare(world)
            await trio.sleep(row.wait_s)
            await robot.acquire()
            await then(robot)

    run_virtual(test)


def test_saf_014_with_the_gate_the_command_is_refused_and_not_sent(world: World, row: Row) -> None:
    async def then(robot: Holder) -> None:
        # A condition that is always checked has stopped the robot already. Its cause is the same.
        refused = await robot.command(row.action)
        assert isinstance(refused, Refused), refused
        assert refused.code == row.code or (row.gate in ALWAYS and refused.code == "faulted"), refused
        assert not frames(world)

    run(world, row, then)


FALLS_S = 20.0

ALWAYS = {condition.check.__name__ for condition in gates.conditions() if condition.always}
"""Conditions that end live control at once."""


def test_saf_014_without_the_gate_the_twin_shows_what_the_robot_does(
    world: World, row: Row, monkeypatch: pytest.MonkeyPatch
) -> None:
    take_out(world.driver, (row.gate, *row.also), monkeypatch)
    if row.owns:
        monkeypatch.setattr(wire_module.BoosterSession, "has_arms", property(lambda session: True))

    async def then(robot: Holder) -> None:
        accepted = await robot.command(row.action)
        assert isinstance(accepted, Accepted), accepted
        async with trio.open_nursery() as nursery:
            nursery.start_soon(watch, world)
            await trio.sleep(LATER_S)
            if row.shows is falls:
                # How long it sways before it falls differs from run to run.
                with trio.move_on_after(FALLS_S):
                    while not world.onboard.body.fallen:  # noqa: ASYNC110  # the body sends no event
                        await trio.sleep(0.1)
            nursery.cancel_scope.cancel()
        row.shows(world)

    run(world, row, then)


async def watch(world: World) -> None:
    """Keep the greatest torque and speed of the elbow."""
    while True:
        state = world.onboard.state()
        for name, value in (("tau", state.tau[4]), ("dq", state.dq[4])):
            world.peaks[name] = max(world.peaks.get(name, 0.0), abs(value))
        await trio.sleep(0.002)


# -- services


class Call(NamedTuple):
    """A call of a service that one check refuses.

    Attributes:
        check: Module and name of the check.
        service: The service.
        arguments: Its arguments.
        code: Code of the refusal.
        status: Status with which the robot itself answers the request.
        own: What the robot itself does.
        mode: Mode of the robot.
    """

    check: tuple[Any, str]
    service: str
    arguments: dict[str, Any]
    code: str
    api: Api
    status: int
    own: str
    mode: Mode = Mode.WALKING


CALLS = (
    Call(
        (gates, "move_refusal"),
        "move",
        {"vx": 0.2},
        "mode",
        Api.MOVE,
        502,
        "it refuses to walk: the change of state failed",
        Mode.PREPARE,
    ),
    Call(
        (gates, "handover_refusal"),
        "enable_upper_body",
        {},
        "mode",
        Api.UPPER_BODY,
        502,
        "it refuses to hand over: the change of state failed",
        Mode.DAMPING,
    ),
    Call(
        (driver_module, "refuse_arguments"),
        "move",
        {"vx": 1.5},
        "past_limit",
        Api.MOVE,
        0,
        "none in the twin: the real robot limits the speed to limits that are not known",
    ),
    Call(
        (driver_module, "refuse_arguments"),
        "rotate_head",
        {"pitch": 2.0},
        "past_limit",
        Api.ROTATE_HEAD,
        0,
        "none in its service: the joint presses against its mechanical stop",
    ),
)
CALLED = pytest.mark.parametrize("call", CALLS, ids=lambda call: f"{call.check[1]}-{call.service}")


def asked(world: World, call: Call) -> list[Any]:
    entries = [entry for entry in world.log.entries() if entry.sender == "host" and b"api_id" in entry.data]
    requests = [decode_request(entry.data) for entry in entries]
    stops = ('{"vx": 0.0', '{"start": false')
    return [each for each in requests if each.api == call.api and not each.body.startswith(stops)]


def in_mode(world: World, call: Call, then: Callable[[Holder], Any]) -> None:
    async def test() -> None:
        async with world.tree() as robot:
            if call.mode is not Mode.WALKING:
                world.onboard.set_mode(call.mode)
                await trio.sleep(0.3)
            await then(robot)

    run_virtual(test)


@CALLED
def test_saf_014_with_the_check_a_service_is_refused_and_not_requested(world: World, call: Call) -> None:
    async def then(robot: Holder) -> None:
        refused = await robot.do(call.service, **call.arguments)
        assert isinstance(refused, Refused) and refused.code == call.code, refused
        assert not asked(world, call)

    in_mode(world, call, then)


@CALLED
def test_saf_014_without_the_check_the_robot_answers_by_itself(
    world: World, call: Call, monkeypatch: pytest.MonkeyPatch
) -> None:
    module, name = call.check
    monkeypatch.setattr(module, name, lambda *_: None)

    async def then(robot: Holder) -> None:
        await robot.do(call.service, **call.arguments)
        await trio.sleep(0.2)
        (request,) = asked(world, call)
        answers = [decode_response(entry.data) for entry in world.log.entries() if entry.kind == "answer"]
        assert [answer.status for answer in answers if answer.id == request.id] == [call.status]
        if call.status:
            assert world.onboard.twist == (0.0, 0.0, 0.0) and not world.onboard.host_has_arms
        elif call.api is Api.MOVE:
            assert world.onboard.twist[0] == 1.5
        else:
            await trio.sleep(2.0)
            assert 1.0 < world.onboard.state().q[1] < 1.22 + 0.05

    in_mode(world, call, then)


def test_the_robot_releases_its_legs_in_the_mode_that_change_mode_refuses(world: World) -> None:
    """The driver has no request for the mode custom. The robot would accept it, and then obey with its legs."""
    assert "custom" not in gates.MODES
    assert world.onboard.serve(wire_module.rpc.Request("1", Api.CHANGE_MODE, '{"mode": 3}')).status == 0
    assert world.onboard.mode is Mode.CUSTOM and world.onboard.fall is Fall.IS_READY
