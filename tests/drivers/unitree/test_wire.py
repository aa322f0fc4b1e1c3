"""Test how the wire judges answers and states, and their age. The test supplies each one, and controls the
clock."""

from __future__ import annotations

from collections.abc import AsyncGenerator, Awaitable, Callable, Iterator
from contextlib import contextmanager
from typing import Any

import pytest
import trio

from strands_actors.contract.driver import Driver
from strands_actors.drivers.common.rtps import CDR
from strands_actors.drivers.common.twin import WireLog
from strands_actors.drivers.unitree import protocol as p
from strands_actors.drivers.unitree import rpc
from strands_actors.drivers.unitree import wire as wire_module
from strands_actors.drivers.unitree.config import UnitreeConfig
from strands_actors.drivers.unitree.driver import G1Driver, Go2Driver
from strands_actors.drivers.unitree.link import MAX_PENDING, Link, Service
from strands_actors.drivers.unitree.protocol import State, StateCodec
from strands_actors.drivers.unitree.robots import model_of
from strands_actors.drivers.unitree.safing import bring_down
from strands_actors.drivers.unitree.twin import UnitreeServer, UnitreeTwinOptions
from strands_actors.drivers.unitree.wire import MAY_LET_GO, UnitreeSession, UnitreeWire
from strands_actors.kernel.clock import NS, MonotonicClock
from strands_actors.kernel.messages import Refused

DRIVERS: dict[str, type[Driver]] = {"unitree_g1": G1Driver, "unitree_go2": Go2Driver}


class Hands(MonotonicClock):
    """A clock that the test advances."""

    def __init__(self) -> None:
        super().__init__()
        self.at_ns = 1000 * NS

    def now_ns(self) -> int:
        return self.at_ns

    def passes(self, seconds: float) -> None:
        self.at_ns += round(seconds * NS)

    async def ticks(self, period_s: float) -> AsyncGenerator[int, None]:
        while True:
            await trio.lowlevel.checkpoint()
            self.passes(period_s)
            yield self.at_ns


class Rig:
    """A session that receives the test's messages, with the conditions on its observation."""

    def __init__(self, robot: str, **options: Any) -> None:
        self.clock = Hands()
        self.model = model_of(robot)
        self.session = UnitreeSession(UnitreeConfig(self.model, "127.9.9.9", **options), self.clock)
        self.link = self.session.link
        self._conditions = DRIVERS[robot](robot, "127.9.9.9", {}).conditions
        self._codec = StateCodec(self.model)
        self._tick = 0

    def says(self, nm: float = 0.0, tick: int | None = None, soc: int = 80, writer: bytes = b"") -> None:
        """Deliver a state. Its tick advances unless one is given. ``writer`` identifies the robot's incarnation."""
        self._tick = self._tick + 2 if tick is None else tick
        count = len(self.model.joints)
        zero, none = (0.0,) * count, (0.0,) * 3
        charge = soc if self.model.family == "go" else None
        upright = (1.0, 0.0, 0.0, 0.0)
        state = State(5, self._tick, upright, none, none, zero, zero, (nm,) * count, (30,) * count, charge)
        self.link._on_state(memoryview(CDR + self._codec.encode(state)), writer, self.clock.at_ns)

    def battery(self, soc: int) -> None:
        """Deliver the charge in the message that this robot uses."""
        if self.model.family == "go":
            self.says(soc=soc)
        else:
            self.session._on_battery(memoryview(CDR + p.encode_battery(soc)), b"", self.clock.at_ns)
            self.says()

    def asked(self) -> int:
        """Let the session send its request of ten times a second. Return the id of that request."""
        self.clock.passes(0.1)
        self.session.poll(self.clock.at_ns)
        return list(self._service._exchange._sent)[-1]

    def answers(self, number: int, api: int, data: str = "", code: int = rpc.OK) -> None:
        body = rpc.encode_response(rpc.Response(number, api, code, data))
        self._service._on_response(memoryview(CDR + body), b"", self.clock.at_ns)

    @property
    def _service(self) -> Service:
        return self.session.fsm or self.session.modes

    def refusals(self) -> list[str]:
        """Return the codes of all conditions that refuse now."""
        seen = self.session.observation()
        checked = (condition.check(seen, self.clock.at_ns) for condition in self._conditions)
        return [refusal.code for refusal in checked if refusal is not None]


@contextmanager
def rig(robot: str, **options: Any) -> Iterator[Rig]:
    made = Rig(robot, **options)
    try:
        yield made
    finally:
        made.link.close()


# -- the battery


@pytest.mark.parametrize("robot", DRIVERS)
def test_saf_014_an_invalid_charge_counts_as_unknown(robot: str) -> None:
    with rig(robot) as legs:
        legs.says()
        legs.battery(255)
        assert "battery_unknown" in legs.refusals()
        assert legs.link.state is not None, "the rest of that state is accepted"


@pytest.mark.parametrize("robot", DRIVERS)
def test_one_invalid_charge_keeps_the_earlier_one(robot: str) -> None:
    with rig(robot) as legs:
        legs.says()
        legs.battery(80)
        assert "battery_unknown" not in legs.refusals()
        legs.clock.passes(5.0)
        legs.battery(255)
        assert legs.session.observation().sensors["battery_pct"] == (80.0,)
        assert "battery_unknown" not in legs.refusals()
        legs.clock.passes(6.0)
        legs.battery(255)
        assert "battery_unknown" in legs.refusals(), "the earlier charge becomes old"


# -- the age of an answer


@pytest.mark.parametrize(("robot", "api", "data", "refused", "grows_old"), [
    ("unitree_g1", rpc.GET_FSM_ID, '{"data": 801}', "fsm_unknown", "fsm_stale"),
    ("unitree_go2", rpc.CHECK_MODE, '{"name": ""}', "sport_mode_unknown", "sport_mode_stale"),
])  # fmt: skip
@pytest.mark.parametrize(("late_s", "counts"), [(0.0, True), (0.9, True), (1.1, False), (2.9, False)])
def test_saf_014_an_answer_is_as_old_as_its_question(
    robot: str, api: int, data: str, refused: str, grows_old: str, late_s: float, counts: bool
) -> None:
    with rig(robot) as legs:
        legs.says()
        legs.battery(80)
        assert legs.refusals() == [refused]
        number = legs.asked()
        legs.clock.passes(late_s)
        legs.answers(number, api, data)
        legs.battery(80)
        assert legs.refusals() == ([] if counts else [grows_old])


@pytest.mark.parametrize(("late_s", "holder"), [(0.0, "FSM 1"), (2.9, "")])
def test_saf_005_an_old_answer_does_not_show_which_mode_holds_the_robot(late_s: float, holder: str) -> None:
    with rig("unitree_g1") as g1:
        number = g1.asked()
        g1.clock.passes(late_s)
        g1.answers(number, rpc.GET_FSM_ID, '{"data": 1}')
        assert g1.session.held_by() == holder


def test_two_questions_of_one_moment_are_answered_each() -> None:
    with rig("unitree_go2") as go2:
        answers: list[str] = []
        go2.session.modes.ask(rpc.CHECK_MODE, lambda response: answers.append("first " + response.data))
        go2.session.modes.ask(rpc.CHECK_MODE, lambda response: answers.append("second " + response.data))
        for number, data in zip(list(go2.session.modes._exchange._sent), ("{}", '{"name": ""}'), strict=True):
            go2.answers(number, rpc.CHECK_MODE, data)
        assert answers == ["first {}", 'second {"name": ""}']


# -- the tick of a state


@pytest.mark.parametrize(("simulator", "counts"), [(False, False), (True, True)])
@pytest.mark.parametrize("robot", DRIVERS)
def test_saf_012_a_state_that_repeats_its_tick_is_not_new(robot: str, simulator: bool, counts: bool) -> None:
    """A simulator's tick may never advance."""
    with rig(robot, simulator=simulator) as legs:
        legs.says(tick=7)
        legs.clock.passes(0.002)
        legs.says(tick=9)
        new_ns = legs.clock.at_ns
        assert "stale" not in legs.refusals()
        for _ in range(60):
            legs.clock.passes(0.002)
            legs.says(nm=5.0, tick=9)
        assert ("stale" not in legs.refusals()) is counts
        assert legs.link.state_ns == (legs.clock.at_ns if counts else new_ns)
        assert legs.link.state is not None and any(legs.link.state.tau) is counts
        legs.clock.passes(0.002)
        for tick in (0, 2):  # it has restarted, and counts from the start
            legs.says(tick=tick, writer=b"another participant")
        assert "stale" not in legs.refusals()


@pytest.mark.parametrize("robot", DRIVERS)
def test_saf_012_a_repeated_state_is_not_new(robot: str) -> None:
    """A network or a proxy may repeat a robot's message."""
    with rig(robot) as legs:
        for tick in (7, 9, 11, 13):
            legs.says(tick=tick)
        new_ns = legs.link.state_ns
        for tick in (7, 9, 11):
            legs.clock.passes(0.05)
            legs.says(nm=5.0, tick=tick)
        assert legs.link.state_ns == new_ns and "stale" in legs.refusals()
        assert legs.link.state is not None and not any(legs.link.state.tau)


@pytest.mark.parametrize("robot", DRIVERS)
def test_saf_012_the_first_state_may_be_one_that_repeats(robot: str) -> None:
    """mode_machine identifies the machine, and proves no more."""
    with rig(robot) as legs:
        for _ in range(3):
            legs.clock.passes(0.002)
            legs.says(tick=7)
        assert legs.link.state is not None and legs.link.state_ns == 0
        assert "no_state" in legs.refusals()
        assert "2 LowStates have arrived, all with a tick that does not advance" in legs.link.unusable
        legs.says(tick=9)
        assert legs.link.state_ns == legs.clock.at_ns and "no_state" not in legs.refusals()


@pytest.mark.parametrize("robot", DRIVERS)
@pytest.mark.parametrize(("nm", "tick", "said"), [
    (0.0, None, ""),
    (60.0, None, "the motor still shows torque"),
    (0.0, 9, "no new LowState has arrived"),
    (0.0, 7, "no new LowState has arrived"),
])  # fmt: skip
def test_saf_005_a_stop_is_confirmed_by_a_new_state_without_torque(
    robot: str, nm: float, tick: int | None, said: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    with rig(robot) as legs:
        legs.says(tick=7)
        legs.says(tick=9)
        legs.clock.passes(0.002)
        monkeypatch.setattr(Link, "matched", True)
        monkeypatch.setattr(legs.link, "poll", lambda: legs.says(nm, tick))
        motors = trio.run(bring_down, legs.link, "zero_torque")
        assert {(motor.safe, motor.detail) for motor in motors} == {(not said, said)}


# -- a request without its answer


def normal_by(go2: Rig) -> str:
    """Answer that the robot's mode is active. Return the name of the mode in control."""
    go2.answers(go2.asked(), rpc.CHECK_MODE, '{"name": "normal"}')
    return go2.session.held_by()


@pytest.mark.parametrize("code", [rpc.OK, rpc.TIMEOUT])
def test_saf_005_an_unanswered_release_leaves_the_holder_unknown(code: int) -> None:
    with rig("unitree_go2") as go2:
        modes = go2.session.modes
        assert normal_by(go2) == "sport mode 'normal'"
        go2.clock.passes(0.1)
        modes.request_action(rpc.RELEASE_MODE)
        (number,) = modes.unanswered
        for _ in range(2 * MAX_PENDING):  # more than are kept
            assert normal_by(go2) == ""
        before = go2.asked()
        go2.clock.passes(0.1)
        go2.answers(number, rpc.RELEASE_MODE, code=code)
        assert not modes.unanswered
        go2.answers(before, rpc.CHECK_MODE, '{"name": "normal"}')
        assert go2.session.held_by() == "", "an answer to a request from before the release does not count"
        assert normal_by(go2) == "sport mode 'normal'"


def test_a_request_that_did_not_arrive_does_not_stay_pending_for_ever() -> None:
    with rig("unitree_go2") as go2:
        go2.session.modes.request_action(rpc.RELEASE_MODE)
        for _ in range(299):
            assert normal_by(go2) == ""
        go2.clock.passes(1.0)
        assert normal_by(go2) == "sport mode 'normal'"


class Free:
    def check(self) -> None:
        pass


def test_saf_005_a_release_that_was_refused_may_still_be_carried_out(monkeypatch: pytest.MonkeyPatch) -> None:
    """It is requested once, however long the robot takes, even if the link is lost."""
    monkeypatch.setattr(wire_module, "RELEASE_S", 0.4)
    model = model_of("unitree_go2")
    server = UnitreeServer(model, WireLog(None), UnitreeTwinOptions())
    late: list[tuple[str, bytes, int]] = []
    carry_out = server._take_request

    def hang(service: str, body: bytes, t_ns: int) -> None:
        if rpc.decode_request(body).api == rpc.RELEASE_MODE:
            late.append((service, body, t_ns))
        else:
            carry_out(service, body, t_ns)

    monkeypatch.setattr(server, "_take_request", hang)
    server.plug()
    wire = UnitreeWire(UnitreeConfig(model, server.address), MonotonicClock())

    async def read() -> None:
        while True:
            await wire.read()
            await trio.sleep(0.005)

    async def details() -> set[tuple[bool, str]]:
        return {(motor.safe, motor.detail) for motor in await wire.make_safe("zero_torque")}

    async def connected(test: Callable[[], Awaitable[None]]) -> None:
        await wire.open()
        async with trio.open_nursery() as reading:
            reading.start_soon(read)
            await test()
            reading.cancel_scope.cancel()

    async def refused() -> None:
        assert await details() == {(True, "held by the robot's own controller, sport mode 'normal'")}
        answer = await wire.perform("release_sport_mode", {"attempts": 2}, Free())
        assert isinstance(answer, Refused) and answer.reason.endswith(MAY_LET_GO), answer
        await unconfirmed()

    async def unconfirmed() -> None:
        found = await details()
        assert (False, f"the motor still shows torque; {MAY_LET_GO}") in found, found
        assert not any("held by" in detail for _, detail in found)

    async def carried_out() -> None:
        await unconfirmed()
        assert len(late) == 1
        carry_out(*late[0])
        answer = await wire.perform("release_sport_mode", {}, Free())
        assert answer == {"sport_mode_released": True, "attempts": 0}
        assert await details() == {(True, "")}

    async def test() -> None:
        async with trio.open_nursery() as nursery:
            nursery.start_soon(server.serve)
            with trio.fail_after(60):
                await connected(refused)
                await connected(carried_out)
            nursery.cancel_scope.cancel()

    try:
        trio.run(test)
    finally:
        wire.close()
        server.close()
