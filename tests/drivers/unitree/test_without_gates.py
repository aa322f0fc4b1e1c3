"""SAF-014: take each gate of the drivers out, and look at what the robot itself does with the command.

Each row has two tests. With the gate, the command is refused and nothing is sent. Without it, the command is sent,
and the twin shows the robot's own behaviour. Many gates have no counterpart on the robot: it obeys, so that only
the gate protects it. The row then says why.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import msgspec
import pytest
import trio

from strands_actors.contract.driver import Candidate, Driver
from strands_actors.drivers import get_native_driver_class
from strands_actors.drivers.common.kit.motor_targets import TAU
from strands_actors.drivers.unitree.link import Link
from strands_actors.drivers.unitree.protocol import Command, CommandCodec
from strands_actors.drivers.unitree.rpc import OK, decode_response
from strands_actors.drivers.unitree.twin.gait import REST
from strands_actors.drivers.unitree.walking.sport import LIE
from strands_actors.kernel.clock import NS
from strands_actors.kernel.messages import Refused
from strands_actors.supervisors.gate.messages import Accepted
from strands_actors.testing import run_virtual
from tests.drivers.without_gates import checks, take_out

from .walking_world import Commander, World

ELBOW, KNEE = "left_elbow", "left_knee"
LATER_S = 0.2
"""The twin is looked at so long after the command."""
Prepare = Callable[[World], None]
Shows = Callable[[World], None]


class Row(NamedTuple):
    """A command that one gate refuses.

    Attributes:
        gate: Name of the gate's function.
        level: Level of the driver.
        robot: The robot.
        action: The command.
        code: Code of the refusal.
        shows: Checks the twin after the command was sent without the gate.
        own: What the robot itself does: its own fault, or the reason why it has none.
        options: Options of the twin.
        prepare: Brings the robot into the state in which the gate refuses.
        also: Other gates that refuse the same command, and are taken out with it.
    """

    gate: str
    level: str
    robot: str
    action: dict[str, Any]
    code: str
    shows: Shows
    own: str
    options: Mapping[str, Any] = MappingProxyType({})
    prepare: Prepare = lambda world: None
    also: tuple[str, ...] = ()


# -- what the twin shows


def last_command(world: World) -> Command:
    entries = [entry for entry in world.log.host("setpoint") if len(entry.data) > 500]
    return CommandCodec(world.server.onboard.model).decode(entries[-1].data)


def obeys(world: World) -> None:
    """The robot obeys a LowCmd."""
    assert world.log.host("setpoint") and world.server.onboard.commanded


def ignores(world: World) -> None:
    """The robot has received a LowCmd, and ignores it."""
    assert world.log.host("setpoint") and not world.server.onboard.commanded


def walks(world: World) -> None:
    assert world.log.host("setpoint") and world.gait.position != [0.0, 0.0]


def stays(world: World) -> None:
    """The robot has received a velocity, and does not walk."""
    assert world.log.host("setpoint") and world.gait.twist == REST and world.gait.position == [0.0, 0.0]


def of(world: World, row: str, joint: str = ELBOW) -> float:
    onboard = world.server.onboard
    values: tuple[float, ...] = getattr(onboard.state(), row)
    return values[onboard.model.axes.index(joint)]


def unanswered(world: World) -> None:
    stays(world)
    sent_ns = world.log.host("setpoint")[0].t_ns
    answers = [entry for entry in world.log.entries(sent_ns) if entry.kind == "answer"]
    move = world.server.onboard.model.service
    assert move == "sport" and all(decode_response(entry.data).api < 1003 for entry in answers)


def answered_and_stays(world: World) -> None:
    stays(world)
    assert any(decode_response(e.data)[1:3] == (1008, OK) for e in world.log.entries() if e.kind == "answer")


def refuses_again(world: World) -> None:
    stays(world)
    codes = [decode_response(e.data).code for e in world.log.entries() if e.kind == "answer"]
    assert codes.count(4201) >= 2


def at_its_stop(world: World) -> None:
    obeys(world)
    joint = next(joint for joint in world.server.onboard.model.joints if joint.key == ELBOW)
    assert of(world, "q") < joint.high + 0.1 and of(world, "tau") > 5.0


def saturated(world: World) -> None:
    obeys(world)
    assert last_command(world).tau[18] == 100.0
    assert world.peaks["tau"] == pytest.approx(25.0, abs=0.1)


def races(world: World) -> None:
    obeys(world)
    assert world.peaks["dq"] > 3.0


def limp(world: World) -> None:
    obeys(world)
    assert of(world, "tau", KNEE) == 0.0 and any(world.server.onboard.state().tau)


def takes_gains(world: World) -> None:
    obeys(world)
    assert last_command(world).kp[18] == 500.0


# -- what is prepared


def silent(world: World) -> None:
    world.server.send_state = lambda *_: None  # type: ignore[method-assign]


def mode_silent(world: World) -> None:
    world.server._gait_writer = None


def in_fsm_1(world: World) -> None:
    world.server.onboard.set_fsm(1)


def released(world: World) -> None:
    world.server.onboard.set_mode("")


def lying(world: World) -> None:
    world.gait.become(LIE)


def refusing(world: World) -> None:
    world.gait.order = lambda api, parameter: (4201, None)  # type: ignore[method-assign]


def not_finite(world: World) -> None:
    """Let the parser put NaN into the torque of a joint that the command does not name. No action can do this."""
    driver, parse = world.driver, world.driver.parse

    def broken(action: Any, state: Any) -> Any:
        candidate = parse(action, state)
        assert isinstance(candidate, Candidate)
        place = len(driver.axes) * TAU + driver.axes.index(KNEE)
        values = tuple(math.nan if at == place else value for at, value in enumerate(candidate.values))
        return msgspec.structs.replace(candidate, values=values)

    driver.parse = broken  # type: ignore[method-assign]


HOME = 1.28
"""Position of the elbow while a G1 stands, rad."""
AT_HOME = {ELBOW: {"q": HOME}}
UNKNOWN = {"battery": "unknown"}
NO_CLOCK = "none: the robot cannot know how old the driver's knowledge of it is"
NO_BATTERY = "none: it obeys until its battery protection cuts the power, which is not modelled"

ROWS = (
    Row("stale", "low", "unitree_g1", AT_HOME, "stale", obeys, NO_CLOCK, {}, silent),
    Row("fsm", "low", "unitree_g1", AT_HOME, "fsm", ignores, "it ignores LowCmd in this state", {}, in_fsm_1),
    Row(
        "sport_mode",
        "low",
        "unitree_go2",
        {"FL_hip_joint": 0.0},
        "sport_mode",
        ignores,
        "it ignores LowCmd while its onboard mode is active",
    ),
    Row(
        "battery_reported",
        "low",
        "unitree_g1",
        AT_HOME,
        "battery_unknown",
        obeys,
        NO_BATTERY,
        UNKNOWN,
    ),
    Row("battery_above", "low", "unitree_g1", AT_HOME, "battery_low", obeys, NO_BATTERY, {"battery": 5}),
    Row(
        "finite_rows",
        "low",
        "unitree_g1",
        AT_HOME,
        "not_finite",
        limp,
        "the motor gets no torque [assumed]",
        {},
        not_finite,
    ),
    Row(
        "past_range",
        "low",
        "unitree_g1",
        {ELBOW: {"q": 2.6, "kp": 60.0}},
        "past_travel",
        at_its_stop,
        "none in its computer: the joint presses against its mechanical stop",
        also=("steps",),
    ),
    Row(
        "within",
        "low",
        "unitree_g1",
        {ELBOW: {"q": HOME, "kp": 0.0, "kd": 1.0, "dq": 50.0}},
        "too_fast",
        races,
        "none: no limit of the motor's own for a speed is known",
    ),
    Row(
        "within",
        "low",
        "unitree_g1",
        {ELBOW: {"q": HOME, "tau": 100.0}},
        "too_strong",
        saturated,
        "the motor gives its greatest torque, 25 Nm, and no more",
    ),
    Row(
        "gains",
        "low",
        "unitree_g1",
        {ELBOW: {"q": HOME, "kp": 500.0}},
        "gain",
        takes_gains,
        "none: no limit of the motor's own for a gain is known",
    ),
    Row(
        "steps",
        "low",
        "unitree_g1",
        {ELBOW: {"q": 0.0, "kp": 60.0}},
        "too_fast",
        races,
        "none: the motor turns to a far target as fast as its torque allows",
    ),
    Row(
        "released",
        "sport",
        "unitree_go2",
        {"vx": 0.5},
        "sport_mode_released",
        unanswered,
        "its service does not answer, and it does not walk",
        {},
        released,
    ),
    Row("mode_reported", "sport", "unitree_go2", {"vx": 0.5}, "mode_stale", walks, NO_CLOCK, {}, mode_silent),
    Row(
        "posture",
        "sport",
        "unitree_go2",
        {"vx": 0.5},
        "posture",
        answered_and_stays,
        "it answers success, and does not walk",
        {},
        lying,
    ),
    Row(
        "battery_reported",
        "sport",
        "unitree_g1",
        {"vx": 0.5},
        "battery_unknown",
        walks,
        NO_BATTERY,
        UNKNOWN,
    ),
    Row("battery_above", "sport", "unitree_go2", {"vx": 0.5}, "battery_low", walks, NO_BATTERY, {"battery": 5}),
    Row(
        "past_range",
        "sport",
        "unitree_go2",
        {"vx": 5.0},
        "past_travel",
        walks,
        "none known: the vendor gives a range, but not what the robot does outside of it",
    ),
)
ELSEWHERE = {"refused_by_robot": "test_a_velocity_after_a_refusal_is_refused_again_by_the_robot"}
"""Gates that need two commands -> their test."""


def test_every_gate_has_a_row() -> None:
    levels = (("unitree_g1", "low"), ("unitree_go2", "low"), ("unitree_go2", "sport"), ("unitree_g1", "sport"))
    for robot, level in levels:
        driver_class = get_native_driver_class(robot)
        assert driver_class is not None and issubclass(driver_class, Driver)
        driver = driver_class.for_level(robot, {"level": level})(robot, "127.0.0.77", {})
        rows = {row.gate for row in ROWS if row.level == level} | set(ELSEWHERE)
        assert set(checks(driver)) <= rows, (robot, level)
    assert all(row.own for row in ROWS)


def run(world: World, row: Row, then: Callable[[Commander], Any]) -> None:
    async def test() -> None:
        async with world.tree() as robot:
            row.prepare(world)
            await trio.sleep(0.35 if row.gate == "mode_reported" else 0.15)
            await then(robot)

    run_virtual(test)


def ids(row: Row) -> str:
    return f"{row.level}-{row.gate}-{row.code}"


@pytest.fixture(params=ROWS, ids=ids)
def row(request: pytest.FixtureRequest) -> Row:
    chosen: Row = request.param
    return chosen


@pytest.fixture
def world(row: Row, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> World:
    return World(tmp_path, monkeypatch, row.robot, row.level, **row.options)


def test_saf_014_with_the_gate_the_command_is_refused_and_not_sent(world: World, row: Row) -> None:
    async def then(robot: Commander) -> None:
        refused = await robot.move(**row.action)
        assert isinstance(refused, Refused) and refused.code == row.code, refused
        assert not world.log.host("setpoint")

    run(world, row, then)


def test_saf_014_without_the_gate_the_twin_shows_what_the_robot_does(
    world: World, row: Row, monkeypatch: pytest.MonkeyPatch
) -> None:
    take_out(world.driver, (row.gate, *row.also), monkeypatch)

    async def then(robot: Commander) -> None:
        accepted = await robot.move(**row.action)
        assert isinstance(accepted, Accepted), accepted
        world.peaks.clear()
        async with trio.open_nursery() as nursery:
            nursery.start_soon(watch, world)
            await trio.sleep(LATER_S)
            nursery.cancel_scope.cancel()
        row.shows(world)

    run(world, row, then)


async def watch(world: World) -> None:
    """Keep the greatest torque and speed of the elbow."""
    if ELBOW not in world.server.onboard.model.axes:
        return
    while True:
        for name in ("tau", "dq"):
            world.peaks[name] = max(world.peaks.get(name, 0.0), abs(of(world, name)))
        await trio.sleep(0.002)


def test_a_velocity_after_a_refusal_is_refused_again_by_the_robot(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for gate in ("refused_by_robot", ""):
        directory = tmp_path / (gate or "without")
        directory.mkdir()
        world = World(directory, monkeypatch, "unitree_go2")
        if not gate:
            take_out(world.driver, ("refused_by_robot",), monkeypatch)
        refusing(world)

        async def test(world: World = world, gate: str = gate) -> None:
            async with world.tree() as robot:
                await robot.move(vx=0.5)
                await trio.sleep(0.05)
                answer = await robot.move(vx=0.4)
                await trio.sleep(0.05)
                if gate:
                    assert isinstance(answer, Refused), answer
                else:
                    refuses_again(world)

        run_virtual(test)


# -- the two numbers that every frame carries


def foreign_machine(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Link, "_machine", property(lambda link: 9))


def wrong_checksum(monkeypatch: pytest.MonkeyPatch) -> None:
    encode = CommandCodec.encode

    def broken(codec: CommandCodec, machine: int, values: Any) -> bytes:
        body = encode(codec, machine, values)
        return body[:-1] + bytes((body[-1] ^ 1,))

    monkeypatch.setattr(CommandCodec, "encode", broken)


@pytest.mark.parametrize(("spoil", "kind"), [(foreign_machine, "other"), (wrong_checksum, "garbled")])
def test_saf_014_a_frame_with_a_wrong_number_is_ignored_by_the_robot(
    spoil: Callable[[pytest.MonkeyPatch], None], kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The driver copies ``mode_machine`` from LowState, and computes the checksum. Without one of them the robot
    stands as if nothing was sent. Users of real robots report both: dimensionalOS/dimos pull request 2861,
    fan-ziqi/rl_sar issue 147."""
    world = World(tmp_path, monkeypatch, "unitree_g1", "low")

    async def test() -> None:
        async with world.tree() as robot:
            began_ns = round(trio.current_time() * NS)
            spoil(monkeypatch)
            assert isinstance(await robot.move(**{ELBOW: {"q": HOME - 0.05}}), Accepted)
            await trio.sleep(0.1)
            assert len(world.log.host(kind, began_ns)) > 20 and not world.log.host("setpoint", began_ns)
            assert not world.server.onboard.commanded and of(world, "q") == pytest.approx(HOME, abs=0.02)
            monkeypatch.undo()

    run_virtual(test)
