"""The envelopes of the drivers page, and an answer that can be used at once or awaited."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Generator
from concurrent.futures import Future
from typing import Any

from .runtime.contract import Observation
from .runtime.messages import Refused
from .supervisors.messages import StopReport, TaskStatus, TreeReport


class Answer(dict[str, Any]):
    """``{"status", "content"}``. Awaiting it gives itself, so ``stop()`` and ``await stop()`` both work."""

    def __await__(self) -> Generator[Any, None, Answer]:
        yield from ()
        return self


class PendingAnswer:
    """What an async verb returns inside a running event loop: already under way, whether awaited or not."""

    def __init__(self, future: Future[Answer]) -> None:
        self._future = future

    def __await__(self) -> Generator[Any, None, Answer]:
        return asyncio.wrap_future(self._future).__await__()


def success(json: dict[str, Any]) -> Answer:
    return Answer(status="success", content=[{"json": json}])


def error(text: str, json: dict[str, Any] | None = None) -> Answer:
    content: list[dict[str, Any]] = [{"text": text}]
    if json is not None:
        content.append({"json": json})
    return Answer(status="error", content=content)


def refused(refusal: Refused) -> Answer:
    details = {key: value for key in ("code", "offered", "limit") if (value := getattr(refusal, key))}
    return error(refusal.text, {"refused": details})


def stopped(report: StopReport) -> Answer:
    """A stop is a success only when every motor confirmed it."""
    json = {
        "stopped": report.confirmed,
        "reason": str(report.reason),
        "rung": report.rung,
        "path": report.path,
        "took_ms": round(report.took_ms, 2),
        "unconfirmed": report.unconfirmed,
        "motors": {
            motor.axis: {
                "id": motor.id,
                "written": motor.written,
                "acknowledged": motor.acknowledged,
                "safe": motor.safe,
                "detail": motor.detail,
            }
            for motor in report.motors
        },
    }
    if report.confirmed:
        return success(json)
    named = ", ".join(f"{motor.axis} (id {motor.id}): {motor.detail}" for motor in report.motors if not motor.safe)
    return error(f"stop: not confirmed by {named or 'the robot'}. cut its power if it still moves", json)


def task(status: TaskStatus) -> dict[str, Any]:
    return {
        "running": status.running,
        "steps": status.steps,
        "elapsed_s": round(status.elapsed_s, 3),
        "exit_reason": status.exit_reason or None,
        "exit_detail": status.exit_detail or None,
        "refusal": status.refusal or None,
        "instruction": status.instruction,
        "hz": round(status.hz, 2),
    }


def sensors(observation: Observation) -> dict[str, list[float | None]]:
    """By name, in axis order; what is not known is null."""
    return {
        name: [None if math.isnan(value) else value for value in row] for name, row in observation.sensors.items()
    }


def tree(report: TreeReport) -> dict[str, Any]:
    """As ``strands-actors tree --json`` prints one robot."""
    return {
        "robot": report.robot,
        "state": report.state,
        "epoch": report.epoch,
        "processes": [
            {"role": process.role, "pid": process.pid, "restarts": process.restarts} for process in report.processes
        ],
        "actors": [
            {
                "address": actor.address,
                "role": actor.role,
                "pid": actor.pid,
                "state": actor.state,
                "restarts": actor.restarts,
            }
            for actor in report.actors
        ],
    }
