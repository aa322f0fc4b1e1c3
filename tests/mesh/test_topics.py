"""A plain zenoh session reads the topics that a robot publishes."""

from __future__ import annotations

import functools
import json
import time
from collections.abc import Iterator
from typing import Any

import msgspec
import pytest
import trio
import zenoh

from strands_actors.caller.processes.run_directory import notes
from strands_actors.contract.sensors import TOPICS_HZ, Sensor
from strands_actors.contract.wire import Observation
from strands_actors.supervisors.gate.messages import Accepted, Acquire, Lease, Release, Setpoint
from strands_actors.testing import FakeHardware
from strands_actors.testing.fake import FakeDriver, FakeWire

from .world import robot_on_mesh, run, until


class Plain:
    """A subscriber that uses zenoh only. Of this project it uses the note with the robot's address."""

    def __init__(self) -> None:
        (note,) = notes()
        config = zenoh.Config()
        config.insert_json5("scouting/multicast/enabled", "false")
        config.insert_json5("connect/endpoints", json.dumps(note.mesh))
        self.session = zenoh.open(config)
        self._subscribers: dict[str, Any] = {}

    def subscribe(self, key: str) -> None:
        self._subscribers[key] = self.session.declare_subscriber(key, zenoh.handlers.FifoChannel(1000))

    def take(self, key: str) -> list[zenoh.Sample]:
        return list(iter(self._subscribers[key].try_recv, None))


@pytest.fixture
def plain() -> Iterator[list[Plain]]:
    made: list[Plain] = []
    yield made
    for each in made:
        each.session.close()


def join(plain: list[Plain], *keys: str) -> Plain:
    plain.append(Plain())
    for key in keys:
        plain[-1].subscribe(key)
    return plain[-1]


def more(seen: list[zenoh.Sample], samples: list[zenoh.Sample]) -> list[zenoh.Sample]:
    """Append the new samples, and return all samples so far."""
    seen += samples
    return seen


def told(sample: zenoh.Sample) -> dict[str, Any]:
    value: dict[str, Any] = json.loads(sample.payload.to_string())
    return value


def sent_s(sample: zenoh.Sample) -> float:
    assert sample.attachment is not None
    return float(json.loads(sample.attachment.to_string())["time_ns"]) / 1e9


def test_state_comes_ten_times_a_second_with_its_schema_number_and_time(plain: list[Plain]) -> None:
    async def test() -> None:
        async with robot_on_mesh() as (robot, _, _):
            key = f"strands/{robot}/state"
            seen: list[zenoh.Sample] = []
            subscriber = join(plain, key)
            began = time.monotonic()
            await until(lambda: len(more(seen, subscriber.take(key))) >= 8, "eight samples")
            took_s = time.monotonic() - began
        assert took_s > 0.6  # not more often
        assert {str(sample.encoding) for sample in seen} == {"application/json;strands.state.v1"}
        stamps = [json.loads(sample.attachment.to_bytes()) for sample in seen if sample.attachment]
        numbers = [stamp["seq"] for stamp in stamps]
        assert numbers == list(range(numbers[0], numbers[0] + len(seen)))
        assert all(abs(stamp["time_ns"] - time.time_ns()) < 60e9 for stamp in stamps)
        state = told(seen[-1])
        assert state["peer_id"] == robot
        assert state["joints"] == {"a": 0.0, "b": 0.0, "a.pos": 0.0, "b.pos": 0.0}  # both spellings
        assert (state["state"], state["degraded"]) == ("armed", False)
        assert state["task"]["status"] == "idle"

    run(test)


def test_a_rollout_of_the_scripts_own_policy_is_seen_while_it_writes(plain: list[Plain]) -> None:
    """The root did not start this rollout and has no record of it."""

    async def test() -> None:
        async with robot_on_mesh() as (robot, tree, _):
            key = f"strands/{robot}/state"
            subscriber = join(plain, key)
            seen: list[zenoh.Sample] = []

            def task() -> dict[str, Any]:
                more(seen, subscriber.take(key))
                return dict(told(seen[-1])["task"]) if seen else {}

            async def write(lease: Lease) -> None:
                deadline_ns = time.monotonic_ns() + 10**9
                setpoint = Setpoint(lease.id, lease.epoch, deadline_ns, {"a": 0.01}, latched=True)
                assert isinstance(await tree.gate.ask(setpoint, 1.0), Accepted)

            async def until_told(status: str, instruction: str, steps: int, what: str) -> None:
                expected = {"status": status, "instruction": instruction, "steps": steps}
                await until(lambda: task() == expected, what)

            own = await tree.gate.ask(Acquire("a script"), 1.0)
            assert isinstance(own, Lease)
            await write(own)
            await until_told("idle", "", 0, "its own setpoint is no task")
            under = await tree.gate.ask(Acquire("a policy", own.id, instruction="pick it up"), 1.0)
            assert isinstance(under, Lease)
            await write(under)
            await until_told("running", "pick it up", 1, "the rollout")
            await tree.gate.ask(Release(under.id), 1.0)
            await until_told("idle", "", 0, "its end")

    run(test)


def test_presence_and_health_have_the_fields_of_the_page(plain: list[Plain]) -> None:
    async def test() -> None:
        async with robot_on_mesh() as (robot, _, _):
            keys = [f"strands/{robot}/presence", f"strands/{robot}/health"]
            subscriber = join(plain, *keys)
            seen: dict[str, list[zenoh.Sample]] = {key: [] for key in keys}

            def look() -> bool:
                for key in keys:
                    seen[key] += subscriber.take(key)
                return all(seen.values())

            await until(look, "presence and health")
        presence, health = (told(seen[key][0]) for key in keys)
        assert (presence["robot_id"], presence["robot_type"], presence["connected"]) == (robot, "robot", True)
        assert presence["action_keys"] == ["a", "b"]
        assert abs(presence["timestamp"] - time.time()) < 60
        assert (health["peer_id"], health["ok"], health["faults"]) == (robot, True, {})

    run(test)


def test_only_sensors_that_a_robot_has_are_published(plain: list[Plain], monkeypatch: pytest.MonkeyPatch) -> None:
    read = FakeWire._observe

    def with_imu(wire: FakeWire) -> Observation:
        return msgspec.structs.replace(
            read(wire), sensors={"gyro_rad_s": (0.1, 0.2, float("nan")), "soc_pct": (80.0,), "load_pct": (3.0,)}
        )

    monkeypatch.setattr(FakeWire, "_observe", with_imu)
    declared = (Sensor("imu", {"gyro": "gyro_rad_s", "rpy": "never_read"}), Sensor("battery", {"pct": "soc_pct"}))
    monkeypatch.setattr(FakeDriver, "SENSORS", declared)

    async def test() -> None:
        async with robot_on_mesh() as (robot, _, _):
            sensors = [f"strands/{robot}/{topic}" for topic in TOPICS_HZ]
            state, imu, battery = (f"strands/{robot}/{topic}" for topic in ("state", "imu", "battery"))
            presence, health = (f"strands/{robot}/{topic}" for topic in ("presence", "health"))
            subscriber = join(plain, state, presence, health, *sensors)
            seen: list[zenoh.Sample] = []
            await until(lambda: len(more(seen, subscriber.take(imu))) >= 3, "three of the imu")
            charges: list[zenoh.Sample] = []
            await until(lambda: more(charges, subscriber.take(battery)), "the battery")
            assert told(charges[0])["pct"] == 80.0
            assert subscriber.take(state)
            assert not any(subscriber.take(key) for key in sensors if key not in (imu, battery))
            listed: list[zenoh.Sample] = []
            await until(lambda: more(listed, subscriber.take(presence)), "presence")
            assert set(told(listed[0])["topics"]) == {"presence", "state", "health", "imu", "battery"}
            rest: list[zenoh.Sample] = []
            await until(lambda: more(rest, subscriber.take(health)), "health")
            assert told(rest[0])["sensors"] == {"load_pct": [3.0]}
        assert {key: value for key, value in told(seen[0]).items() if key != "t"} == {
            "peer_id": robot,
            "gyro": [0.1, 0.2, None],
        }
        assert str(seen[0].encoding) == "application/json;strands.imu.v1"

    run(test)


@pytest.mark.long
def test_saf_012_no_sensor_publishes_an_old_value_as_a_new_one(
    plain: list[Plain], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A silent or unplugged robot gives no readings."""
    read = FakeWire._observe

    def with_imu(wire: FakeWire) -> Observation:
        row = {"gyro_rad_s": (0.1, 0.2, 0.3), "load_pct": (3.0,), "temperature_c": (20.0, 21.0)}
        return msgspec.structs.replace(read(wire), sensors=row)

    monkeypatch.setattr(FakeWire, "_observe", with_imu)
    monkeypatch.setattr(FakeDriver, "SENSORS", (Sensor("imu", {"gyro": "gyro_rad_s"}),))

    async def test(fault: str) -> None:
        hardware = FakeHardware()
        async with robot_on_mesh(hardware) as (robot, tree, _):
            hardware.read_s = 0.06
            imu, state, health = (f"strands/{robot}/{topic}" for topic in ("imu", "state", "health"))
            subscriber = join(plain, imu, state, health)
            seen: list[zenoh.Sample] = []
            healthy: list[zenoh.Sample] = []
            await until(lambda: len(more(seen, subscriber.take(imu))) >= 5, "the imu")
            late_s = max(sent_s(sample) - told(sample)["t"] for sample in seen)
            assert late_s > 0.03, "t must be the time of the reading"
            await until(lambda: more(healthy, subscriber.take(health)), "its health")
            assert told(healthy[-1])["temps"] == {"a": 20.0, "b": 21.0}
            assert "load_pct" in told(healthy[-1])["sensors"]
            setattr(hardware, fault, False)
            await trio.sleep(1.5)
            subscriber.take(imu), subscriber.take(state), subscriber.take(health)
            await trio.sleep(0.5)
            assert subscriber.take(state) and not subscriber.take(imu)
            assert (await tree.status()).observation is not None, "the subscriber would have received it"
            healthy.clear()
            await until(lambda: more(healthy, subscriber.take(health)), "its health, still")
            assert not {"temps", "sensors"} & set(told(healthy[-1]))

    for fault in ("answers", "plugged"):
        run(functools.partial(test, fault))


def test_a_robot_is_found_by_its_token_and_missed_without(plain: list[Plain]) -> None:
    async def test() -> None:
        async with robot_on_mesh() as (robot, _, service):
            alive: dict[str, bool] = {}

            def on_change(sample: zenoh.Sample) -> None:
                alive[str(sample.key_expr)] = sample.kind == zenoh.SampleKind.PUT

            subscriber = join(plain)
            watch = subscriber.session.liveliness().declare_subscriber(
                "strands/*/alive", zenoh.handlers.Callback(on_change, indirect=False), history=True
            )
            await until(lambda: alive == {f"strands/{robot}/alive": True}, "the token is there")
            service.close()
            await until(lambda: alive == {f"strands/{robot}/alive": False}, "the token is gone")
            del watch

    run(test)


def test_the_wire_gets_no_requests_without_subscribers(plain: list[Plain]) -> None:
    async def test() -> None:
        async with robot_on_mesh() as (robot, tree, _):
            asked = 0
            gate = tree.node.cells[tree.gate.address].actor
            status = gate._status  # type: ignore[attr-defined]

            def counted() -> Any:
                nonlocal asked
                asked += 1
                return status()

            gate._status = counted  # type: ignore[attr-defined]
            await trio.sleep(1.0)
            assert asked <= 1  # the list of sensors is read every two seconds
            join(plain, f"strands/{robot}/state")
            await until(lambda: asked > 5, "now it is asked")

    run(test)


def test_a_subscriber_to_all_topics_sees_no_message_between_actors(plain: list[Plain]) -> None:
    async def test() -> None:
        async with robot_on_mesh() as (robot, _, _):
            subscriber = join(plain, "strands/**")
            seen: list[zenoh.Sample] = []
            await until(lambda: len(more(seen, subscriber.take("strands/**"))) > 15, "telemetry")
            assert {str(sample.key_expr).removeprefix(f"strands/{robot}/") for sample in seen} <= {
                "state",
                "presence",
                "health",
            }

    run(test)
