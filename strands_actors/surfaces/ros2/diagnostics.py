"""The state of a robot as diagnostic_msgs/msg/DiagnosticArray. Pure."""

from __future__ import annotations

import enum
from typing import Any, NamedTuple

from strands_actors.contract.shown import harmless
from strands_actors.supervisors.gate.failsafe import Mode

from .readings import header
from .samples import Health, Presence


class Level(enum.IntEnum):
    """The levels of diagnostic_msgs/msg/DiagnosticStatus."""

    OK = 0
    WARN = 1
    ERROR = 2
    STALE = 3


LEVELS: dict[str, Level] = {
    Mode.ARMED: Level.OK,
    Mode.HOLDING: Level.OK,
    Mode.ARMING: Level.OK,
    Mode.STOPPING: Level.WARN,
    Mode.DISARMED: Level.WARN,
    Mode.ENDING: Level.WARN,
    Mode.ENDED: Level.WARN,
    Mode.DOWN: Level.ERROR,
    Mode.LOST: Level.ERROR,
    Mode.UNCONFIRMED: Level.ERROR,
    Mode.FAILED: Level.ERROR,
}
"""The level of each mode of the failsafe machine. A robot with a fault is an error in any mode."""


class Summary(NamedTuple):
    """The newest facts about a robot.

    Attributes:
        presence: Its newest presence; None before the first one.
        health: Its newest health, which is published every two seconds; None before the first one.
        age_s: The age of its newest reading, in seconds; None if it was not read.
        writer: The program that commands the robot over the graph; empty without such a program.
        refused: The number of messages of the graph that were refused.
        last_refusal: The text of the last of these refusals, with its remedy.
    """

    presence: Presence | None = None
    health: Health | None = None
    age_s: float | None = None
    writer: str = ""
    refused: int = 0
    last_refusal: str = ""


def diagnostics(robot: str, summary: Summary, now_s: float) -> dict[str, Any]:
    """Return the message for one robot.

    Args:
        robot: The name of the robot.
        summary: The newest facts about it.
        now_s: The time of the wall clock, in seconds.
    """
    presence, health = summary.presence or Presence(hw=""), summary.health or Health()
    faults = ", ".join(f"{name}: {fault}" for name, fault in health.faults.items())
    level = LEVELS.get(presence.state, Level.ERROR)
    message = presence.state or "unreachable"
    if presence.locked_by:
        level, message = max(level, Level.WARN), f"{message}, locked by {presence.locked_by}"
    if faults or health.connect_error:
        level, message = Level.ERROR, f"{message}: {faults or health.connect_error}"
    values = {
        "type": presence.hw,
        "state": presence.state,
        "epoch": str(presence.epoch),
        "connected": str(presence.connected),
        "lease": presence.lease,
        "locked_by": presence.locked_by,
        "cause": health.cause,
        "last_stop_cause": health.last_stop_cause,
        "connect_error": health.connect_error,
        "faults": faults,
        "reading_age_s": "" if summary.age_s is None else f"{summary.age_s:.3f}",
        "refusals": str(health.refusals),
        "last_refusal": health.last_refusal,
        "ros_writer": summary.writer,
        "ros_refusals": str(summary.refused),
        "ros_last_refusal": summary.last_refusal,
    }
    status = {
        "level": int(level),
        "name": f"{robot}: state",
        "message": harmless(message),
        "hardware_id": robot,
        "values": [{"key": key, "value": harmless(value)} for key, value in values.items()],
    }
    return {"header": header(now_s), "status": [status]}
