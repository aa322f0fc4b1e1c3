"""Test the hand's codec, and the requests of the wire process: one at a time, and no stop of fingers that stand."""

from __future__ import annotations

import contextlib
from typing import Any, cast

import pytest
import trio
from hypothesis import given
from hypothesis import strategies as st
from trio.testing import MockClock

from strands_actors.contract.driver import GateState
from strands_actors.contract.wire import Observation
from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.drivers.common.kit.outcome import Outcome
from strands_actors.drivers.franka import hand as hands
from strands_actors.drivers.franka import hand_protocol as p
from strands_actors.drivers.franka.driver import Franka
from strands_actors.drivers.franka.hand import FrankaHand
from strands_actors.drivers.franka.hand_client import HandClient
from strands_actors.drivers.franka.hand_protocol import Command, HandState, Status
from strands_actors.drivers.franka.protocol import Decoder, Message
from strands_actors.kernel.clock import NS
from strands_actors.kernel.messages import Refused

HOST = "192.0.2.1"
FULL_SPEED = (100.0, 100.0)


# -- the codec


@given(
    st.integers(0, 2**32 - 1),
    st.floats(-0.5, 0.5),
    st.floats(0.0, 0.5),
    st.booleans(),
    st.integers(0, 2**16 - 1),
)
def test_a_state_survives_there_and_back(number: int, width: float, most: float, grasped: bool, hot: int) -> None:
    state = HandState(number, width, most, grasped, hot)
    assert p.state(state.pack()) == state


@given(st.binary(max_size=64))
def test_garbage_is_a_malformed_frame(data: bytes) -> None:
    with contextlib.suppress(MalformedFrame):
        p.state(data)
    with contextlib.suppress(MalformedFrame):
        for message in Decoder(p.LARGEST_MESSAGE, p.HEADER).feed(data):
            p.status_of(message)


@pytest.mark.parametrize("width", [float("nan"), float("inf"), 1.5, -2.0])
def test_a_width_that_no_hand_has_is_malformed(width: float) -> None:
    with pytest.raises(MalformedFrame):
        p.state(HandState(1, width, 0.08, False, 30).pack())


# -- the requests of the wire process


class Now:
    """A clock that the test moves."""

    def __init__(self) -> None:
        self._now_ns = NS

    def now_ns(self) -> int:
        return self._now_ns

    def advance(self, seconds: float) -> None:
        self._now_ns += round(seconds * NS)


class Free:
    """A permit that is never denied."""

    def check(self) -> None: ...


class Service:
    """Both ends of a hand's service, which answers what the test says."""

    name = "the hand"
    own_host = "192.0.2.9"
    peer_host = HOST

    def __init__(self, clock: Now) -> None:
        self._clock = clock
        self.requests: list[Message] = []
        self._replies: list[bytes] = []
        self._states: list[bytes] = []
        self._ms = 0

    def write(self, data: bytes) -> None:
        self.requests += Decoder(p.LARGEST_MESSAGE, p.HEADER).feed(data)

    def read_waiting(self) -> bytes | None:
        return self._replies.pop(0) if self._replies else None

    def recvfrom(self, size: int) -> tuple[bytes, tuple[str, int]]:
        if not self._states:
            raise BlockingIOError
        return self._states.pop(0), (HOST, 1)

    def close(self) -> None: ...

    def show(self, width_m: float, most_m: float = 0.08, grasped: bool = False, passed_s: float = 0.02) -> None:
        self._clock.advance(passed_s)
        self._ms += round(passed_s * 1e3)
        self._states.append(HandState(self._ms, width_m, most_m, grasped, 30).pack())

    def reply(self, command: Command, number: int, status: Status) -> None:
        self._replies.append(p.frame(command, number, int(status).to_bytes(2, "little")))

    @property
    def commands(self) -> list[Command]:
        return [Command(request.code) for request in self.requests]


class World:
    def __init__(self) -> None:
        self.clock = Now()
        self.service = Service(self.clock)
        client = HandClient(cast("Any", self.service), cast("Any", self.service), cast("Any", self.clock))
        self.hand = FrankaHand(Franka("panda", HOST, {"gripper": "franka_hand"}).config, cast("Any", self.clock))
        self.hand._client = client
        self.see(0.08)

    def see(self, width_m: float, **more: Any) -> None:
        self.service.show(width_m, **more)
        self.hand.read(self.clock.now_ns())

    def order(self, opening: float, force: float = 100.0) -> None:
        self.see(0.08, passed_s=0.06)
        self.hand.follow((opening, 100.0, force), Free())


def confirmed(world: World, since_ns: int) -> Outcome:
    return trio.run(world.hand.confirm, since_ns, clock=MockClock(autojump_threshold=0))


def test_a_closing_is_a_grasp_with_a_force_and_any_other_target_a_motion() -> None:
    world = World()
    world.order(50.0)
    world.service.reply(Command.MOVE, 0, Status.SUCCESS)
    world.order(0.0, force=0.0)
    (move, _, width), (grasp, _, payload) = world.service.requests
    assert (move, grasp) == (Command.MOVE, Command.GRASP)
    assert p.MOVE.unpack(width) == pytest.approx((0.04, 0.1))
    assert p.GRASP.unpack(payload)[4] == pytest.approx(5.0)


def test_a_new_target_waits_until_the_last_motion_was_stopped() -> None:
    world = World()
    world.order(50.0)
    world.order(20.0)
    world.order(20.0)
    assert world.service.commands == [Command.MOVE, Command.STOP], "one stop is enough"
    world.service.reply(Command.MOVE, 0, Status.ABORTED)
    world.service.reply(Command.STOP, 1, Status.SUCCESS)
    world.order(20.0)
    world.order(20.0)
    assert world.service.commands == [Command.MOVE, Command.STOP, Command.MOVE]


def test_an_answer_to_another_request_does_not_end_a_motion() -> None:
    world = World()
    world.order(50.0)
    world.service.reply(Command.STOP, 0, Status.SUCCESS)
    world.service.reply(Command.MOVE, 7, Status.SUCCESS)
    world.order(20.0)
    assert world.service.commands == [Command.MOVE, Command.STOP]


def test_saf_003_a_stop_sends_nothing_to_a_hand_that_stands() -> None:
    world = World()
    world.order(50.0)
    world.service.reply(Command.MOVE, 0, Status.SUCCESS)
    for _ in range(10):
        world.see(0.04)
    since_ns = world.hand.begin_stop()
    assert world.service.commands == [Command.MOVE]
    world.see(0.04)
    outcome = confirmed(world, since_ns)
    assert (outcome.acknowledged, outcome.detail) == (True, "")


def test_saf_022_a_stop_of_a_moving_hand_is_not_confirmed_while_it_moves() -> None:
    world = World()
    world.order(0.0)
    world.see(0.07)
    since_ns = world.hand.begin_stop()
    assert world.service.commands[-1] is Command.STOP
    world.see(0.06)
    assert (confirmed(world, since_ns)).detail == "the fingers move"
    world.service.reply(Command.GRASP, 0, Status.ABORTED)
    world.service.reply(Command.STOP, 1, Status.SUCCESS)
    for _ in range(10):
        world.see(0.06)
    assert (confirmed(world, since_ns)).detail == ""


def test_a_refused_motion_and_silence_are_faults_and_nothing_is_sent_then() -> None:
    world = World()
    world.order(50.0)
    world.service.reply(Command.MOVE, 0, Status.FAIL)
    world.order(20.0)
    assert "refused" in world.hand.fault and world.service.commands == [Command.MOVE]
    silent = World()
    silent.clock.advance(2 * hands.SILENT_S)
    silent.hand.read(silent.clock.now_ns())
    assert "no state" in silent.hand.fault


def test_a_hand_that_was_not_homed_gets_no_target() -> None:
    world = World()
    world.see(0.04, most_m=0.0)
    assert "home_gripper first" in world.hand.fault
    world.hand.follow((50.0, *FULL_SPEED), Free())
    assert world.service.requests == []


# -- actions


def parsed(action: dict[str, float]) -> object:
    driver = Franka("panda", HOST, {"gripper": "franka_hand"})
    state = GateState(0, Observation(0, (), ()), (0.0,) * 8, 0, stream=False)
    return driver.parse(action, state)


def test_a_force_is_refused_for_a_motion_that_is_no_grasp() -> None:
    refused = parsed({"gripper": 50.0, "gripper_force": 10.0})
    assert isinstance(refused, Refused) and "no setting for gripper_force" in refused.text
    assert not isinstance(parsed({"gripper": 0.0, "gripper_force": 10.0}), Refused)
