"""The robots as the console shows them: the newest sample of each topic, and the last events. Pure, except for the
clock that ``Viewer`` uses."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Sequence
from typing import Any

import msgspec

from strands_actors.contract.shown import harmless
from strands_actors.kernel.channels.pubsub import Received
from strands_actors.supervisors.mesh.schemas import EVENT_KEY, TELEMETRY, is_name, key
from strands_actors.surfaces.mesh.client import MeshClient
from strands_actors.surfaces.view.events import Event
from strands_actors.surfaces.view.model import Frame, RobotModel
from strands_actors.surfaces.view.samples import Task
from strands_actors.surfaces.view.sinks import Reading
from strands_actors.surfaces.view.viewer import SILENT_S, Viewer

MOST_EVENTS = 100
"""Number of events that are kept of each robot."""
FLEET_S = 0.4
"""How old the list of all robots for the pages may be, in seconds. All pages get the same one."""
FORGET_S = 3600.0
"""After so long without a sample, in seconds, a robot is forgotten."""


class Summary(msgspec.Struct, frozen=True):
    """A robot in the list of all robots.

    Attributes:
        name: Name of the robot.
        type: Its type; empty until it is known.
        host: The computer that it runs on.
        state: State of the robot.
        epoch: Number of stops and holds.
        connected: True while the link to the robot works.
        lease: The program that commands the robot; empty if the lease is free.
        locked_by: The operator of the e-stop; empty without a lock.
        task: The running task; empty without one.
        age_s: Age of the newest positions in seconds; -1 without a reading.
        silent_s: How long no sample has arrived, in seconds.
        battery: Charge in percent; None if the robot does not report it.
        cause: Why the robot is in its safe state.
        last_refusal: The last refused setpoint, with its remedy.
        problem: The fault of the link or of a motor; empty without one.
    """

    name: str
    type: str
    host: str
    state: str
    epoch: int
    connected: bool
    lease: str
    locked_by: str
    task: str
    age_s: float
    silent_s: float
    battery: float | None
    cause: str
    last_refusal: str
    problem: str


class Watched:
    """One robot. It is a ``Sink`` of a ``Viewer``, which decodes the samples."""

    def __init__(self, name: str, now_s: Callable[[], float]) -> None:
        self.name = name
        self.topics: dict[str, dict[str, Any]] = {}
        """The newest sample of each topic but ``state``, as a mapping."""
        self.joints: Reading | None = None
        self.events: deque[Event] = deque(maxlen=MOST_EVENTS)
        self.event_count = 0
        """Number of events so far, also of those that were dropped."""
        self.last_s = now_s()
        self.viewer = Viewer(name, [self])
        self._now_s = now_s

    def receive(self, received: Received) -> None:
        self.last_s = self._now_s()
        self.viewer.receive(received)

    # -- Sink

    def reading(self, reading: Reading) -> None:
        self.joints = reading

    def topic(self, t: float, topic: str, values: dict[str, Any]) -> None:
        self.topics[topic] = values

    def event(self, event: Event) -> None:
        self.events.append(event)
        self.event_count += 1

    def model(self, model: RobotModel) -> None:
        raise NotImplementedError("the browser draws the model")

    def frames(self, t: float, frames: Sequence[Frame]) -> None:
        raise NotImplementedError("the browser computes the frames")

    def picture(self, t: float, camera: str, jpeg: bytes) -> None:
        raise NotImplementedError("pictures have connections of their own")

    def close(self) -> None:
        pass

    # -- for pages

    @property
    def is_silent(self) -> bool:
        return self._now_s() - self.last_s > SILENT_S

    def summary(self) -> Summary:
        presence, state, health = self.viewer.presence, self.viewer.state, self.viewer.health
        problems = (
            [health.connect_error, *(f"{motor}: {text}" for motor, text in health.faults.items())] if health else []
        )
        return Summary(
            name=self.name,
            type=harmless(presence.hw) if presence else "",
            host=harmless(presence.hostname) if presence else "",
            state=harmless(state.state) if state else "",
            epoch=state.epoch if state else 0,
            connected=bool(presence and presence.connected),
            lease=harmless(presence.lease) if presence else "",
            locked_by=harmless(presence.locked_by) if presence else "",
            task=_task(state.task) if state else "",
            age_s=state.age_s if state else -1.0,
            silent_s=round(self._now_s() - self.last_s, 1),
            battery=self._battery(),
            cause=harmless(state.cause) if state else "",
            last_refusal=harmless(state.last_refusal) if state else "",
            problem=harmless("; ".join(filter(None, problems))),
        )

    def _battery(self) -> float | None:
        percent = self.topics.get("battery", {}).get("pct")
        return float(percent) if isinstance(percent, int | float) else None


class Robots:
    """All robots on the mesh.

    Args:
        now_s: A clock that does not jump, in seconds.
    """

    def __init__(self, now_s: Callable[[], float]) -> None:
        self._now_s = now_s
        self._robots: dict[str, Watched] = {}
        self._fleet = ""
        self._fleet_s = -math.inf

    def watch(self, client: MeshClient) -> None:
        """Receive the telemetry of all robots from now on. Pictures are left out."""
        for topic in TELEMETRY:
            client.subscribe(key("*", topic), self.receive)
        client.subscribe(EVENT_KEY, self.receive_event)

    def receive(self, received: Received) -> None:
        name = received.key.split("/", 2)[1]
        if not is_name(name):
            return
        robot = self._robots.get(name)
        if robot is None:
            robot = self._robots[name] = Watched(name, self._now_s)
        robot.receive(received)

    def receive_event(self, received: Received) -> None:
        for robot in self._robots.values():
            robot.viewer.receive(received)

    def get(self, name: str) -> Watched | None:
        return self._robots.get(name)

    def look(self) -> None:
        """Notice robots that are silent. Call this a few times a second."""
        now_s = self._now_s()
        for name, robot in list(self._robots.items()):
            if now_s - robot.last_s > FORGET_S:
                del self._robots[name]
            else:
                robot.viewer.look()

    def fleet(self) -> str:
        """Return the message with the summaries, for all pages."""
        now_s = self._now_s()
        if now_s - self._fleet_s >= FLEET_S:
            self._fleet_s = now_s
            self._fleet = msgspec.json.encode({"type": "fleet", "robots": self.summaries()}).decode()
        return self._fleet

    def summaries(self) -> list[Summary]:
        return [robot.summary() for _, robot in sorted(self._robots.items())]


def _task(task: Task) -> str:
    return harmless(task.instruction or "running") if task.status == "running" else ""
