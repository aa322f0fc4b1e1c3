"""Turn the samples of one robot into readings, frames and events for the displays.

A sample that cannot be decoded is reported as an event, once for each topic, and left out.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import trio

from strands_actors.contract.shown import harmless
from strands_actors.kernel.channels.pubsub import Received
from strands_actors.supervisors.mesh.schemas import EVENT_KEY

from .events import Event, EventFinder, Kind, Level
from .model import RobotModel, positions_of
from .samples import BadSample, Health, Presence, SafetyEvent, State, decode, joints_of
from .sinks import Reading, Sink

SILENT_S = 1.0
"""After so long without a sample of ``state``, in seconds, the robot counts as silent. It sends ten a second."""


class Viewer:
    """Shows one robot.

    Args:
        robot: Name of the robot.
        sinks: The displays.
        on_problem: Called with the text of each problem of the view itself.
        now: The wall clock, in seconds. Tests pass another one.
        elapsed: A clock that does not jump, in seconds. Tests pass another one.
    """

    def __init__(
        self,
        robot: str,
        sinks: Sequence[Sink],
        on_problem: Callable[[str], None] = lambda text: None,
        now: Callable[[], float] = time.time,
        elapsed: Callable[[], float] = time.monotonic,
    ) -> None:
        self.robot = robot
        self.presence: Presence | None = None
        """The newest sample of ``presence``."""
        self.state: State | None = None
        """The newest sample of ``state``."""
        self.health: Health | None = None
        """The newest sample of ``health``."""
        self.identified = trio.Event()
        """Set when ``presence`` has a sample."""
        self.readings = 0
        """Number of samples of ``state`` so far."""
        self._sinks = sinks
        self._on_problem = on_problem
        self._now = now
        self._events = EventFinder()
        self._model: RobotModel | None = None
        self._newest: Reading | None = None
        self._elapsed = elapsed
        self._last_state_at = self._last_look_at = elapsed()
        self._is_silent = False
        self._bad_topics: set[str] = set()

    async def show_model(self, model: RobotModel) -> None:
        """Show the robot's model from now on. Its meshes are encoded in a worker thread, since that takes long."""
        for sink in self._sinks:
            await trio.to_thread.run_sync(sink.model, model)
        self._model = model
        self._show_frames()

    def problem(self, text: str) -> None:
        """Report a problem of the view itself."""
        self._on_problem(text)
        self._show([Event(self._now(), Kind.PROBLEM, Level.WARNING, "view", text)])

    def receive(self, received: Received) -> None:
        """Take one sample of the robot's telemetry."""
        topic = received.key.split("/", 2)[2]
        try:
            if received.key == EVENT_KEY:
                safety = decode(received.payload, SafetyEvent)
                if safety.peer_id == self.robot:
                    self._show(self._events.safety(safety))
            elif topic == "state":
                self._state(decode(received.payload, State))
            elif topic.startswith("camera/"):
                for sink in self._sinks:
                    sink.picture(received.sent_s or self._now(), topic.removeprefix("camera/"), received.payload)
            else:
                self._other(topic, received.payload)
        except BadSample as bad:
            if topic not in self._bad_topics:
                self._bad_topics.add(topic)
                self.problem(harmless(f"samples of {topic} cannot be read, and are left out: {bad}"))

    def look(self) -> None:
        """Notice if the robot has become silent. Call this a few times a second."""
        now_s = self._elapsed()
        if now_s - self._last_look_at > SILENT_S / 2:
            # This process was late itself, and samples may wait for it.
            self._last_state_at = now_s
        self._last_look_at = now_s
        if self.readings and not self._is_silent and now_s - self._last_state_at > SILENT_S:
            self._is_silent = True
            text = f"no telemetry has arrived for {SILENT_S:g} s. The robot has ended, or cannot be reached"
            self._show([Event(self._now(), Kind.SILENT, Level.ERROR, "silent", text)])

    def _state(self, state: State) -> None:
        self.state = state
        self._last_state_at = self._elapsed()
        self.readings += 1
        if self._is_silent:
            self._is_silent = False
            self._show([Event(state.t, Kind.SILENT, Level.INFO, "back", "telemetry arrives again")])
        joints = joints_of(state)
        reading = Reading(self.robot, state.t, state.age_s, state.state, state.epoch, state.unit, joints)
        self._newest = reading
        for sink in self._sinks:
            sink.reading(reading)
        self._show_frames()
        self._show(self._events.state(state))

    def _show_frames(self) -> None:
        reading, presence = self._newest, self.presence
        if self._model is None or reading is None or presence is None:
            return
        measured = {joint.name: joint.measured for joint in reading.joints if joint.measured is not None}
        frames = self._model.frames(positions_of(measured, presence.model_units))
        for sink in self._sinks:
            sink.frames(reading.read_t, frames)

    def _other(self, topic: str, payload: bytes) -> None:
        t = self._now()
        if topic == "presence":
            self.presence = decode(payload, Presence)
            self.identified.set()
            t = self.presence.timestamp
            self._show(self._events.presence(self.presence))
        elif topic == "health":
            health = self.health = decode(payload, Health)
            t = health.t
            self._show(self._events.health(health))
        values = decode(payload, dict[str, Any])
        for sink in self._sinks:
            sink.topic(t, topic, values)

    def _show(self, events: Iterable[Event]) -> None:
        for event in events:
            for sink in self._sinks:
                sink.event(event)
