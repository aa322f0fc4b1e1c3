"""A driver's services, conditions and timing, and a stop channel that is kept ready. In virtual time."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import msgspec
import pytest
import trio

from strands_actors.contract.driver import Condition, Reason, Service, Timing
from strands_actors.contract.wire import Observation, Permit, WireDown
from strands_actors.kernel.clock import NS
from strands_actors.kernel.messages import Message, Refused
from strands_actors.supervisors.gate.messages import Accepted, Perform, Performed, Resume, Stop, StopReport
from strands_actors.testing import open_inline_tree, run_virtual
from strands_actors.testing.fake import FakeDriver, FakeStopChannel, FakeWire

from .writer import Writer, armed, setpoints

DONE: list[tuple[str, int]] = []
"""Each write of a service: its name and its time."""


@pytest.fixture(autouse=True)
def waves(monkeypatch: pytest.MonkeyPatch) -> None:
    """Give the fake robot a service: to wave, with ``times`` writes 0.1 s apart."""
    DONE.clear()

    async def perform(
        self: FakeWire, service: str, arguments: Mapping[str, Any], permit: Permit
    ) -> dict[str, Any] | Refused:
        times = int(arguments.get("times", 3))
        if times > 50:
            raise WireDown("the hand is not there")
        if times > 20:
            return Refused("tired", "the hand is tired")
        for _ in range(times):
            permit.check()
            DONE.append((service, self._clock.now_ns()))
            await trio.sleep(0.1)
        return {"waved": times}

    monkeypatch.setattr(
        FakeDriver, "SERVICES", {"wave": Service("wave a hand", within_s=1.0, arguments={"times": 3})}
    )
    monkeypatch.setattr(FakeWire, "perform", perform)


async def ask(writer: Writer, service: str = "wave", **arguments: Any) -> Message | None:
    return await writer.ref.ask(Perform(writer.lease.id, writer.lease.epoch, service, arguments), 5.0)


def test_a_service_reaches_the_wire_and_is_answered() -> None:
    async def run() -> None:
        async with open_inline_tree() as tree:
            writer = await armed(tree)
            assert await ask(writer, times=2) == Performed({"waved": 2})
            assert len(DONE) == 2

    run_virtual(run)


@pytest.mark.parametrize(("service", "arguments", "code"), [
    ("dance", {}, "unknown_service"),
    ("wave", {"hand": "left"}, "unknown_argument"),
    ("wave", {"times": 21}, "tired"),
    ("wave", {"times": 51}, "not_connected"),
    ("wave", {"times": 20}, "timeout"),  # would take two seconds
])  # fmt: skip
def test_saf_014_a_service_that_is_refused_or_fails(service: str, arguments: dict[str, Any], code: str) -> None:
    async def run() -> None:
        async with open_inline_tree() as tree:
            answer = await ask(await armed(tree), service, **arguments)
            assert isinstance(answer, Refused) and answer.code == code
            assert len(DONE) <= 10
            began = len(DONE)
            await trio.sleep(3.0)
            assert len(DONE) == began  # the service is not continued later

    run_virtual(run)


def test_saf_002_a_service_that_powers_motors_is_refused_between_a_stop_and_a_resume(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Also if the wire of a stopped robot could perform it, because the motors may still have power."""
    powers = Service("stand up", within_s=1.0, arguments={"times": 3}, powers=True)
    monkeypatch.setattr(FakeDriver, "SERVICES", {"wave": powers})

    async def run() -> None:
        async with open_inline_tree() as tree:
            writer = await armed(tree)
            assert await ask(writer, times=1) == Performed({"waved": 1})
            await tree.gate.ask(Stop(Reason.STOP), 1.0)
            await writer.acquire()
            answer = await ask(writer)
            assert isinstance(answer, Refused) and answer.code == "disarmed"
            assert answer.reason.startswith("the robot is disarmed")
            assert len(DONE) == 1
            await tree.gate.ask(Resume(), 1.0)
            await writer.acquire()
            assert await ask(writer, times=1) == Performed({"waved": 1})

    run_virtual(run)


@pytest.mark.parametrize(("releases", "times", "runs"), [
    (True, 1, True),
    ({"times": 1}, 1, True),
    ({"times": 1}, 2, False),
    ({"times": 3}, None, True),  # the default of the service
    ({"times": 1}, None, False),
])  # fmt: skip
def test_a_service_that_only_takes_power_away_runs_on_a_stopped_robot(
    releases: bool | dict[str, Any], times: int | None, runs: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    relax = Service("relax", within_s=1.0, arguments={"times": 3}, powers=True, releases=releases)
    monkeypatch.setattr(FakeDriver, "SERVICES", {"relax": relax})

    async def run() -> None:
        async with open_inline_tree() as tree:
            writer = await armed(tree)
            await tree.gate.ask(Stop(Reason.STOP), 1.0)
            await writer.acquire()
            answer = await ask(writer, "relax", **({} if times is None else {"times": times}))
            assert isinstance(answer, Performed) is runs, answer
            assert bool(DONE) is runs

    run_virtual(run)


def test_saf_009_a_service_needs_the_lease_and_the_current_epoch() -> None:
    async def run() -> None:
        async with open_inline_tree() as tree:
            writer = await armed(tree)
            other = Writer(tree, "other")
            answer = await ask(other)
            assert isinstance(answer, Refused) and answer.code == "lease"
            await tree.gate.ask(Stop(Reason.STOP), 1.0)
            answer = await ask(writer)
            assert isinstance(answer, Refused) and answer.code == "stale_epoch"
            assert DONE == []

    run_virtual(run)


def test_saf_007_a_lockout_refuses_services_too() -> None:
    async def run() -> None:
        async with open_inline_tree() as tree:
            writer = await armed(tree)
            await tree.gate.ask(Stop(Reason.ESTOP, "op", lock=True), 1.0)
            await writer.acquire()
            answer = await ask(writer)
            assert isinstance(answer, Refused) and answer.code == "locked_out"
            assert DONE == []

    run_virtual(run)


def test_saf_002_a_stop_ends_a_service_and_no_write_of_it_follows() -> None:
    async def run() -> None:
        async with open_inline_tree() as tree:
            writer = await armed(tree)
            answers: list[Message | None] = []

            async def wave() -> None:
                answers.append(await ask(writer, times=9))

            async with trio.open_nursery() as nursery:
                nursery.start_soon(wave)
                await trio.sleep(0.25)
                stopped_ns = tree.node.clock.now_ns()
                report = await tree.gate.ask(Stop(Reason.STOP), 1.0)
                assert isinstance(report, StopReport) and report.confirmed
                # The stop did not wait for the service.
                assert tree.node.clock.now_ns() - stopped_ns < 0.05 * NS
            assert isinstance(answers[0], Refused) and answers[0].code == "stopped"
            await trio.sleep(1.0)
            assert [at_ns for _, at_ns in DONE if at_ns > stopped_ns] == []

    run_virtual(run)


def test_a_service_and_setpoints_exclude_each_other() -> None:
    async def run() -> None:
        async with open_inline_tree() as tree:
            writer = await armed(tree)
            async with trio.open_nursery() as nursery:
                nursery.start_soon(ask, writer)
                await trio.sleep(0.05)
                answer = await writer.send(a=1.0)
                assert isinstance(answer, Refused) and answer.code == "busy"
            assert isinstance(await writer.send(latched=True, a=1.0), Accepted)
            answer = await ask(writer)
            assert isinstance(answer, Refused) and answer.code == "live"

    run_virtual(run)


def test_a_command_that_comes_with_a_service_is_checked_and_written_before_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    waving = Service("wave a hand", within_s=1.0, arguments={"times": 3}, in_motion=True)
    monkeypatch.setattr(FakeDriver, "SERVICES", {"wave": waving})

    async def run() -> None:
        async with open_inline_tree() as tree:
            writer = await armed(tree)

            async def both(**action: Any) -> Message | None:
                lease, first = writer.lease, writer.setpoint(latched=True, **action)
                return await writer.ref.ask(Perform(lease.id, lease.epoch, "wave", {"times": 1}, first), 5.0)

            assert await both(a=1.0) == Performed({"waved": 1})
            written = tree.hardware.of("setpoint")[0]
            assert written.values[0] == 1.0
            assert written.t_ns <= DONE[0][1]
            answer = await both(nobody=1.0)
            assert isinstance(answer, Refused) and "nobody" in answer.text
            assert len(DONE) == 1, "the service was refused together with the command"
            assert {values[0] for values in setpoints(tree)} == {1.0}

    run_virtual(run)


def test_a_service_without_in_motion_accepts_no_command() -> None:
    async def run() -> None:
        async with open_inline_tree() as tree:
            writer = await armed(tree)
            lease, first = writer.lease, writer.setpoint(latched=True, a=1.0)
            answer = await writer.ref.ask(Perform(lease.id, lease.epoch, "wave", {}, first), 5.0)
            assert isinstance(answer, Refused) and answer.code == "live"
            assert DONE == []
            assert not tree.hardware.of("setpoint")

    run_virtual(run)


def test_one_service_at_a_time() -> None:
    async def run() -> None:
        async with open_inline_tree() as tree:
            writer = await armed(tree)
            async with trio.open_nursery() as nursery:
                nursery.start_soon(ask, writer)
                await trio.sleep(0.05)
                answer = await ask(writer)
                assert isinstance(answer, Refused) and answer.code == "busy"
            assert len(DONE) == 3

    run_virtual(run)


# -- conditions


class Weather:
    """A condition of the robot that a test changes."""

    def __init__(self) -> None:
        self.storm = False

    def __call__(self, observation: Observation, now_ns: int) -> Refused | None:
        return Refused("storm", "it storms", "wait") if self.storm else None


def test_a_condition_may_have_its_own_reason_and_safe_state(monkeypatch: pytest.MonkeyPatch) -> None:
    """This one makes the robot limp where the driver's table would hold it. It is checked in a hold, too."""
    weather = Weather()
    grounded = Condition(weather, Reason.LINK, "limp", always=True)
    monkeypatch.setattr(FakeDriver, "conditions", (grounded,))
    monkeypatch.setattr(FakeDriver, "fallbacks", dict.fromkeys(Reason, "hold"))

    async def run() -> None:
        async with open_inline_tree() as tree:
            writer = await armed(tree)
            assert isinstance(await writer.send(ttl_s=0.1, a=1.0), Accepted)
            await trio.sleep(0.3)
            assert (await tree.status()).mode == "holding"
            weather.storm = True
            await trio.sleep(0.05)
            last = tree.hardware.of("safe")[-1]
            status = await tree.status()
            assert (last.safe_state, status.mode, status.cause) == ("limp", "disarmed", "it storms")
            assert not any(tree.hardware.energised)

    run_virtual(run)


def test_a_condition_refuses_commands_and_ends_a_live_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """The gate checks it at every tick, without any message."""
    weather = Weather()
    monkeypatch.setattr(FakeDriver, "conditions", (Condition(weather),))

    async def run() -> None:
        async with open_inline_tree() as tree:
            writer = await armed(tree)
            weather.storm = True
            answer = await writer.send(latched=True, a=1.0)
            assert isinstance(answer, Refused) and answer.code == "storm"
            assert tree.hardware.of("setpoint") == []
            await trio.sleep(0.1)
            assert (await tree.status()).mode == "armed"  # no command was live, so the mode does not change
            weather.storm = False
            assert isinstance(await writer.send(latched=True, a=1.0), Accepted)
            await trio.sleep(0.1)
            weather.storm = True
            stormed_ns = tree.node.clock.now_ns()
            await tree.until("disarmed")
            safe = tree.hardware.of("safe", stormed_ns)[0]
            assert safe.safe_state == "limp"
            assert safe.t_ns - stormed_ns <= 2 * round(FakeDriver.timing.tick_s * NS)
            assert tree.hardware.of("setpoint", safe.t_ns) == []
            assert (await tree.status()).cause == "it storms"

    run_virtual(run)


# -- clocks


def quick(**changes: Any) -> Timing:
    return msgspec.structs.replace(FakeDriver.timing, **changes)


def test_a_frozen_wire_is_fenced_after_the_drivers_heartbeat_time(monkeypatch: pytest.MonkeyPatch) -> None:
    timing = quick(tick_s=0.002, heartbeat_ttl_s=0.016, control_hz=500.0, keepalive_s=0.002)
    monkeypatch.setattr(FakeDriver, "timing", timing)

    async def run() -> None:
        async with open_inline_tree() as tree:
            await trio.sleep(0.1)
            tree.hardware.read_hangs = True
            frozen_ns = tree.node.clock.now_ns()
            with trio.fail_after(1.0):
                while not tree.hardware.of("safe", frozen_ns):  # noqa: ASYNC110  # the hardware sends no event
                    await trio.sleep(0.001)
            safe = tree.hardware.of("safe", frozen_ns)[0]
            assert safe.path == "stop_channel"
            assert 0.010 * NS < safe.t_ns - frozen_ns <= 0.040 * NS
            tree.hardware.read_hangs = False

    run_virtual(run)


# -- the stop channel


def test_no_arming_before_the_stop_channel_is_ready(monkeypatch: pytest.MonkeyPatch) -> None:
    ready = trio.Event()
    ended: list[str] = []

    async def serve(self: FakeStopChannel, task_status: Any = trio.TASK_STATUS_IGNORED) -> None:
        await ready.wait()
        task_status.started()
        try:
            await trio.sleep_forever()
        finally:
            ended.append("served")

    monkeypatch.setattr(FakeStopChannel, "serve", serve)

    async def run() -> None:
        async with trio.open_nursery() as nursery:

            async def release() -> None:
                await trio.sleep(1.0)
                ready.set()

            nursery.start_soon(release)
            began = trio.current_time()
            async with open_inline_tree() as tree:
                assert trio.current_time() - began >= 1.0
                await armed(tree)
                assert ended == []
                tree.wire._scope.cancel()  # The wire ends: its stop channel is used, closed, and opened again.
                await tree.until("disarmed")
                assert ended == ["served"]

    run_virtual(run)


def test_a_stop_channel_that_cannot_be_opened_keeps_the_robot_unarmed(monkeypatch: pytest.MonkeyPatch) -> None:
    """It costs no restarts, because it is tried again with pauses."""
    attempts: list[float] = []

    async def serve(self: FakeStopChannel, task_status: Any = trio.TASK_STATUS_IGNORED) -> None:
        attempts.append(trio.current_time())
        if len(attempts) < 4:
            raise WireDown("nobody is there")
        task_status.started()

    monkeypatch.setattr(FakeStopChannel, "serve", serve)

    async def run() -> None:
        async with open_inline_tree() as tree:
            assert len(attempts) == 4
            assert len(tree.wires_made) == 1
            await armed(tree)

    run_virtual(run)


def test_saf_003_a_stop_channel_that_is_lost_stops_the_robot(monkeypatch: pytest.MonkeyPatch) -> None:
    lost = trio.Event()

    async def serve(self: FakeStopChannel, task_status: Any = trio.TASK_STATUS_IGNORED) -> None:
        task_status.started()
        await lost.wait()
        raise WireDown("its socket is gone")

    monkeypatch.setattr(FakeStopChannel, "serve", serve)

    async def run() -> None:
        nonlocal lost
        async with open_inline_tree() as tree:
            writer = await armed(tree)
            assert isinstance(await writer.send(latched=True, a=1.0), Accepted)
            before, lost = lost, trio.Event()
            before.set()
            while len(tree.wires_made) < 2:  # noqa: ASYNC110  # the list has no event
                await trio.sleep(0.01)
            await tree.until("disarmed")
            assert tree.keeper.last_report is not None and tree.keeper.last_report.path == "stop_channel"
            answer = await tree.gate.ask(Resume("test"), 1.0)
            assert not isinstance(answer, Refused)

    run_virtual(run)
