"""A session with a Reachy Mini over the REST interface of its daemon."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from typing import Any

import httpx

from strands_actors.drivers.reachy import protocol as p

from .compare import Event

FULL = "/api/state/full"
GOAL: Mapping[str, Any] = {
    "head_pose": {"x": 0.0, "y": 0.005, "z": 0.01, "roll": 0.1, "pitch": 0.15, "yaw": 0.3},
    "antennas": [0.5, -0.4],
    "body_yaw": 0.2,
    "duration": 1.0,
    "interpolation": "minjerk",
}
NEUTRAL: Mapping[str, Any] = {
    "head_pose": dict.fromkeys(("x", "y", "z", "roll", "pitch", "yaw"), 0.0),
    "antennas": [0.0, 0.0],
    "body_yaw": 0.0,
    "duration": 1.0,
}
EVERY_S = 0.03
LONGEST_S = 15.0
SETTLE_S = 1.5
QUIET_S = 1.0
"""Longer than the pause between two parts of a sequence, in which no move is listed."""


class Daemon:
    """The REST interface at one address."""

    def __init__(self, address: str) -> None:
        # The daemon closes a connection after an error, so each request gets a new one.
        limits = httpx.Limits(max_keepalive_connections=0)
        self._http = httpx.Client(base_url=f"http://{address}", trust_env=False, timeout=10.0, limits=limits)

    def get(self, path: str) -> Any:
        return self._http.get(path).json()

    def ask(self, name: str, method: str, path: str, body: Mapping[str, Any] | None = None) -> Event:
        """Send a request, and return its answer as an event: the code, and the names of its fields."""
        answer = self._http.request(method, path, json=body)
        return Event(name, answer=_shape(answer))

    def uuid(self, path: str, body: Mapping[str, Any] | None = None) -> str:
        """Begin a move, and return its id."""
        found: str = self._http.post(path, json=body).json()["uuid"]
        return found

    def readings(self) -> dict[str, float]:
        """Return the pose in radians and metres."""
        state = self.get(FULL)
        pose, antennas = state["head_pose"], state["antennas_position"]
        named = {name: float(pose[name]) for name in ("x", "y", "z", "roll", "pitch", "yaw")}
        return {**named, "right": antennas[0], "left": antennas[1], "body_yaw": float(state["body_yaw"])}

    def settled(self) -> dict[str, float]:
        time.sleep(SETTLE_S)
        return self.readings()

    def end_of_moves(self, quiet_s: float = 0.0) -> float:
        """Wait until no move has been listed for ``quiet_s``, and return the time at which the last one ended."""
        began_s = ended_s = time.monotonic()
        while self.get(p.RUNNING) or time.monotonic() - ended_s < quiet_s:
            if self.get(p.RUNNING):
                ended_s = time.monotonic()
            if time.monotonic() - began_s > LONGEST_S:
                raise RuntimeError(f"a move runs for more than {LONGEST_S:g} s")
            time.sleep(EVERY_S)
        return ended_s if quiet_s else time.monotonic()

    def half_way(self, reading: str, goal: float, start: float) -> float:
        """Wait until a reading has made half of its way to the goal, and return the time."""
        began_s = time.monotonic()
        while abs(self.readings()[reading] - start) < 0.5 * abs(goal - start):
            if time.monotonic() - began_s > LONGEST_S:
                raise RuntimeError(f"{reading} does not move to {goal:g}")
            time.sleep(EVERY_S)
        return time.monotonic()

    def close(self) -> None:
        self._http.close()


def _shape(answer: httpx.Response) -> str:
    """Return the code of an answer, and the names of the fields of its JSON object."""
    try:
        body = answer.json()
    except ValueError:
        return f"{answer.status_code}, no JSON"
    fields = ", ".join(sorted(body)) if isinstance(body, dict) else type(body).__name__
    return f"{answer.status_code}: {fields}"


def session(address: str) -> Iterator[Event]:
    """Run the session, and yield its events."""
    daemon = Daemon(address)
    try:
        yield from _identity(daemon)
        yield from _move(daemon)
        yield from _targets(daemon)
        yield from _errors(daemon)
        yield from _motors(daemon)
    finally:
        daemon.close()


def _identity(daemon: Daemon) -> Iterator[Event]:
    yield daemon.ask("status", "GET", p.STATUS)
    yield daemon.ask("motors", "GET", p.MOTORS)
    yield daemon.ask("state", "GET", FULL)
    yield daemon.ask("torque on", "POST", f"{p.SET_MODE}enabled")
    yield daemon.ask("unknown path", "GET", "/api/nothing")


def _move(daemon: Daemon) -> Iterator[Event]:
    daemon.uuid(p.GOTO, NEUTRAL)
    daemon.end_of_moves()
    neutral = daemon.settled()
    yield Event("neutral", values=neutral)
    began_s = time.monotonic()
    yield daemon.ask("goto", "POST", p.GOTO, GOAL)
    half_s = daemon.half_way("yaw", GOAL["head_pose"]["yaw"], neutral["yaw"])
    yield Event("half way", took_s=half_s - began_s)
    yield Event("end of the move", took_s=daemon.end_of_moves() - began_s)
    yield Event("pose after the move", values=daemon.settled())
    moving = daemon.uuid(p.GOTO, {**NEUTRAL, "duration": 4.0})
    time.sleep(0.5)
    yield daemon.ask("target during a move", "POST", p.SET_TARGET, {"target_antennas": [1.0, 1.0]})
    began_s = time.monotonic()
    yield daemon.ask("stop", "POST", p.STOP, {"uuid": moving})
    yield Event("no move after the stop", took_s=daemon.end_of_moves() - began_s)
    yield daemon.ask("stop again", "POST", p.STOP, {"uuid": moving})
    before = daemon.settled()
    after = daemon.settled()
    still = {name: after[name] - before[name] for name in before}
    yield Event("stands after the stop", values=still)


def _targets(daemon: Daemon) -> Iterator[Event]:
    daemon.uuid(p.GOTO, NEUTRAL)
    daemon.end_of_moves()
    pose = {"x": 0.0, "y": 0.0, "z": 0.0, "roll": 0.0, "pitch": -0.2, "yaw": 0.0}
    target = {"target_head_pose": pose, "target_antennas": [-0.6, 0.7], "target_body_yaw": 0.0}
    yield daemon.ask("target", "POST", p.SET_TARGET, target)
    yield Event("pose after the target", values=daemon.settled())
    yield daemon.ask("target of the antennas alone", "POST", p.SET_TARGET, {"target_antennas": [0.0, 0.0]})
    yield Event("pose after the antennas", values=daemon.settled())


def _errors(daemon: Daemon) -> Iterator[Event]:
    yield daemon.ask("goto without a duration", "POST", p.GOTO, {"antennas": [0.1, 0.1]})
    yield daemon.ask("antennas with three numbers", "POST", p.GOTO, {"antennas": [0.1, 0.1, 0.1], "duration": 1.0})
    yield daemon.ask("a text as body yaw", "POST", p.GOTO, {"body_yaw": "left", "duration": 1.0})
    yield daemon.ask("unknown mode of the motors", "POST", f"{p.SET_MODE}strong")
    yield daemon.ask("stop of an unknown move", "POST", p.STOP, {"uuid": "00000000-0000-4000-8000-000000000000"})
    daemon.end_of_moves()


def _motors(daemon: Daemon) -> Iterator[Event]:
    yield daemon.ask("torque off", "POST", f"{p.SET_MODE}disabled")
    began_s = time.monotonic()
    yield daemon.ask("goto without torque", "POST", p.GOTO, {**NEUTRAL, "antennas": [0.5, 0.5]})
    yield Event("end of the move without torque", took_s=daemon.end_of_moves() - began_s)
    yield daemon.ask("torque on again", "POST", f"{p.SET_MODE}enabled")
    began_s = time.monotonic()
    daemon.uuid(p.WAKE_UP)
    yield Event("end of waking up", took_s=daemon.end_of_moves(QUIET_S) - began_s)
    yield Event("pose when awake", values=daemon.settled())


__all__ = ["session"]
