"""Publish presence, state, health and the sensors of a robot.

A topic without subscribers costs nothing: the gate is not asked for it, and nothing is encoded.
"""

from __future__ import annotations

import os
import socket
import time
from collections.abc import Callable, Iterable, Mapping
from typing import Any, NamedTuple

from strands_actors.contract.driver import Driver
from strands_actors.contract.sensors import TOPICS_HZ, Sensor
from strands_actors.contract.wire import Observation
from strands_actors.kernel.actor import Actor
from strands_actors.kernel.channels.pubsub import PubSub, Topic
from strands_actors.kernel.messages import Message
from strands_actors.kernel.node import AskTimeout, Ref, Unreachable
from strands_actors.supervisors import addresses
from strands_actors.supervisors.gate.failsafe import LINKED
from strands_actors.supervisors.gate.gate import OBSERVATION_S, Gate
from strands_actors.supervisors.gate.messages import GetStatus, Status
from strands_actors.supervisors.root.messages import TaskStatus

from . import schemas as mesh_json
from .readings import mode_of, state_of, task_of

TICK_S = 0.1
ASK_S = 0.05


class Rate(NamedTuple):
    """How often one topic is published."""

    topic: str
    every: int  # number of ticks from one message to the next
    sensor: Sensor | None = None


RATES = (Rate("presence", 5), Rate("state", 1), Rate("health", 20))
"""2, 10 and 0.5 Hz. Each sensor that the driver declares adds its topic, at that topic's rate."""


def rates_of(driver: Driver) -> tuple[Rate, ...]:
    """Return every topic of a robot."""
    every = {topic: round(1 / (TICK_S * hz)) for topic, hz in TOPICS_HZ.items()}
    return (*RATES, *(Rate(sensor.topic, every[sensor.topic], sensor) for sensor in driver.SENSORS))


class Tick(Message, frozen=True):
    lane = "latest"

    now_ns: int


class Telemetry(Actor):
    """Publish the topics of one robot.

    Args:
        robot: Name of the robot.
        driver: Driver of the robot.
        pubsub: The session on the mesh.
        task: Returns the status of the task that the root has started.
        counts: Returns the root's counters for ``health``.
        restarts: Returns how often each process of the robot was started again.
        cameras: Returns the names of the cameras that have given a picture.
    """

    def __init__(
        self,
        robot: str,
        driver: Driver,
        pubsub: PubSub,
        task: Callable[[], TaskStatus],
        counts: Callable[[], Mapping[str, int]],
        restarts: Callable[[], Mapping[str, int]],
        cameras: Callable[[], Iterable[str]] = tuple,
    ) -> None:
        self._robot = robot
        self._driver = driver
        self._rates = rates_of(driver)
        self._pubsub = pubsub
        self._task = task
        self._counts = counts
        self._restarts = restarts
        self._cameras = cameras
        self._host = socket.gethostname()
        self._model_units = _model_units(driver)
        self._topics: dict[str, Topic] = {}
        self._ticks = 0

    async def started(self) -> None:
        self._gate: Ref = self.context.ref(addresses.of(self._robot).gate, Gate)
        for rate in self._rates:
            self._declare(rate.topic)
        self._pubsub.declare_token(mesh_json.key(self._robot, "alive"))
        self.context.every(TICK_S, Tick)

    def _declare(self, topic: str) -> None:
        self._topics[topic] = self._pubsub.topic(mesh_json.key(self._robot, topic), mesh_json.schema(topic))

    async def receive(self, message: Tick) -> None:
        number, self._ticks = self._ticks, self._ticks + 1
        due = [rate for rate in self._rates if number % rate.every == 0]
        subscribed = [rate for rate in due if self._topics[rate.topic].has_subscribers]
        if not subscribed:
            return
        status = await self._ask()
        for rate in subscribed:
            sample = self._sample(rate, status)
            if sample is not None:
                self._topics[rate.topic].put(mesh_json.encode(sample))

    async def _ask(self) -> Status | None:
        try:
            answer = await self._gate.ask(GetStatus(), ASK_S)
        except (AskTimeout, Unreachable):
            return None
        return answer if isinstance(answer, Status) else None

    def _sample(self, rate: Rate, status: Status | None) -> dict[str, Any] | None:
        if rate.topic == "presence":
            return self._presence(status)
        if rate.topic == "health":
            return self._health(status)
        observation = None if status is None else status.observation
        if rate.topic == "state":
            return state_of(self._robot, self._driver, self._task(), status)
        if status is None or observation is None or rate.sensor is None or not self._is_fresh(status):
            return None
        reading = rate.sensor.read(observation.sensors)
        return {"peer_id": self._robot, "t": time.time() - status.age_s, **reading} if reading else None

    def _is_fresh(self, status: Status) -> bool:
        """Return True if the reading is recent enough to publish. An old value would look like a new one, so a
        sensor's topic is silent when there is no recent value."""
        longest_s = max(self._driver.timing.state_ttl_s, OBSERVATION_S)
        return status.mode in LINKED and 0.0 <= status.age_s <= longest_s

    def _presence(self, status: Status | None) -> dict[str, Any]:
        task = task_of(self._task(), status)
        return {
            "robot_id": self._robot,
            "robot_type": "robot",
            "hostname": self._host,
            "timestamp": time.time(),
            "tool_name": self._robot,
            "hw": self._driver.robot,
            "connected": status is not None and status.connected,
            "state": mode_of(status),
            "epoch": 0 if status is None else status.epoch,
            "locked_by": "" if status is None else status.locked_by,
            "lease": "" if status is None else status.holder,
            "task_status": "running" if task.running else "idle",
            "instruction": task.instruction,
            "action_keys": list(self._driver.axes),
            "model_units": self._model_units,
            "topics": self._available(status),
            "pid": os.getpid(),
        }

    def _available(self, status: Status | None) -> list[str]:
        """Return the names of the topics. For some sensors the driver does not know the fields in advance
        (``Sensor.prefix``). Their topic is listed once the robot has reported a value. ``lidar`` is added if there
        is any lidar topic, since strands-robots uses this name. Cameras are listed once they have a picture."""
        sensors = {} if status is None or status.observation is None else status.observation.sensors
        topics = [
            rate.topic
            for rate in self._rates
            if rate.sensor is None or not rate.sensor.prefix or rate.sensor.read(sensors)
        ]
        topics += ["lidar"] * any(topic.startswith("lidar/") for topic in topics)
        return topics + [mesh_json.camera_topic(name) for name in sorted(self._cameras())]

    def _charge_and_heat(self, observation: Observation) -> dict[str, Any]:
        """Return ``battery_pct`` and ``temps`` if the robot measures them. Subscribers of strands-robots expect
        them in ``health``."""
        values: dict[str, Any] = {}
        for sensor in self._driver.SENSORS:
            if sensor.topic == "battery" and (charge := sensor.read(observation.sensors).get("pct")) is not None:
                values["battery_pct"] = charge
        heat = observation.sensors.get("temperature_c", ())
        if len(heat) == len(self._driver.axes):
            values["temps"] = dict(zip(self._driver.axes, heat, strict=True))
        return values

    def _health(self, status: Status | None) -> dict[str, Any]:
        health: dict[str, Any] = {
            "peer_id": self._robot,
            "t": time.time(),
            "ok": status is not None and status.mode in LINKED and not _faults(status),
            "connected": status is not None and status.connected,
            "counts": dict(self._counts()),
            "restarts": dict(self._restarts()),
        }
        if status is not None:
            health |= {
                "cause": status.cause,
                "last_stop_cause": status.last_stop_cause,
                "connect_error": status.connect_error,
                "faults": _faults(status),
                "refusals": status.refusals,
                "last_refusal": status.last_refusal,
                "writes": status.writes,
                "reads": status.reads,
                "setpoint_intervals": status.intervals,
                "setpoint_intervals_s": status.intervals_s,
            }
            if status.observation is not None and self._is_fresh(status):
                health |= self._charge_and_heat(status.observation)
                health["sensors"] = {
                    name: row
                    for name, row in status.observation.sensors.items()
                    if not any(sensor.publishes(name) for sensor in self._driver.SENSORS)
                }
        return health


def _model_units(driver: Driver) -> dict[str, tuple[float, float]]:
    """Return (zero, scale) of each axis, as ``Driver.model_units`` has them, and of joints that are only read."""
    read_only = {joint.key: (0.0, 1.0) for joint in driver.READ_ONLY_JOINTS if joint.unit in ("rad", "m")}
    return {**read_only, **dict(zip(driver.axes, driver.model_units(), strict=True))}


def _faults(status: Status) -> dict[str, str]:
    return {} if status.observation is None else dict(status.observation.faults)
