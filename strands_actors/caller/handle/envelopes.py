"""Make envelopes, the results of verbs. They can be used at once or awaited.

An envelope has one of two forms:

    {"status": "success", "content": [{"json": {...}}]}
    {"status": "error", "content": [{"text": "..."}, {"json": {...}}]}
"""

from __future__ import annotations

import logging
import math
import sys
from collections.abc import Coroutine, Generator, Iterator, Mapping
from concurrent.futures import Future
from typing import Any, assert_never

from strands_actors.contract.driver import Driver, Reason
from strands_actors.contract.wire import Observation
from strands_actors.kernel.health import busy
from strands_actors.kernel.messages import Refused
from strands_actors.kernel.refusals import Code
from strands_actors.supervisors.gate.messages import Status, StopReport
from strands_actors.supervisors.root.messages import UNREACHABLE, TaskStatus, TreeReport
from strands_actors.supervisors.stop_result import Confirmed, NothingRan, StopResult, Unconfirmed, Unreachable

from . import refusals

_log = logging.getLogger("strands_actors")


class Answer(dict[str, Any], Coroutine[Any, Any, "Answer"]):
    """An envelope, a dict of ``status`` ("success" or "error") and ``content``.

    It can also be awaited, and the result is the envelope itself. So ``stop()``, ``await stop()`` and
    ``asyncio.run(robot.stop())`` all work.
    """

    def __await__(self) -> Generator[Any, None, Answer]:
        yield from ()
        return self

    def send(self, value: Any) -> Any:
        """End this coroutine at once, with the envelope as its result."""
        raise StopIteration(self)

    def throw(self, typ: Any, val: Any = None, tb: Any = None) -> Any:
        """Raise the exception. This coroutine has no code that could handle it."""
        raise typ

    def close(self) -> None:
        """No-op: the answer is complete."""


class PendingAnswer(Mapping[str, Any], Coroutine[Any, Any, Answer]):
    """The result of ``stop()`` and ``get_status()`` inside a running event loop.

    The call has already started, and runs to its end even if it is never awaited or the awaiting task
    is cancelled. ``await``, ``create_task``, ``gather`` and ``wait_for`` accept it, and do not block the
    loop. If it is read as a dict, as in a cell of a notebook, the reader waits for the answer.
    """

    def __init__(self, future: Future[Answer]) -> None:
        self._future = future
        self._driven: Coroutine[Any, Any, Answer] | None = None

    def __hash__(self) -> int:
        # ``gather`` keeps coroutines as keys of a dict, so they need a hash.
        return id(self)

    def __await__(self) -> Generator[Any, Any, Answer]:
        return _when_done(self._future).__await__()

    def send(self, value: Any) -> Any:
        """Resume the wait for the answer, as a coroutine does. The first call begins the wait."""
        return self._drive().send(value)

    def throw(self, typ: Any, val: Any = None, tb: Any = None) -> Any:
        """Raise an exception in the wait, such as its cancellation. The call itself continues."""
        return self._drive().throw(typ)

    def close(self) -> None:
        """Stop waiting. The call itself continues."""
        if self._driven is not None:
            self._driven.close()

    def _drive(self) -> Coroutine[Any, Any, Answer]:
        if self._driven is None:
            self._driven = _when_done(self._future)
        return self._driven

    def __getitem__(self, key: str) -> Any:
        return self._future.result()[key]

    def __iter__(self) -> Iterator[str]:
        return iter(self._future.result())

    def __len__(self) -> int:
        return len(self._future.result())

    def __bool__(self) -> bool:
        """Return True without waiting, since no answer is empty.

        asyncio calls this when it prints a task (Python 3.12).
        """
        return True

    def __repr__(self) -> str:
        return repr(self._future.result())


async def _when_done(future: Future[Answer]) -> Answer:
    # asyncio is imported already, since an asyncio loop awaits this coroutine.
    import asyncio

    return await asyncio.shield(asyncio.wrap_future(future))


def in_asyncio() -> bool:
    """Return True if an asyncio loop runs in this thread.

    It does not import asyncio, since that takes 8 ms. A program with an asyncio loop has imported it already.
    """
    asyncio = sys.modules.get("asyncio")
    return asyncio is not None and asyncio._get_running_loop() is not None


def success(json: dict[str, Any]) -> Answer:
    """Return the envelope of a success, with ``json`` as its content."""
    return Answer(status="success", content=[{"json": json}])


def picture(png: bytes, json: dict[str, Any]) -> Answer:
    """Return an envelope with a picture in the form that agents expect."""
    image = {"format": "png", "source": {"bytes": png}}
    return Answer(status="success", content=[{"image": image}, {"json": json}])


def error(text: str, json: dict[str, Any] | None = None) -> Answer:
    """Return the envelope of an error.

    Args:
        text: What happened, and what to do.
        json: Further facts, such as the fields of a refusal.
    """
    content: list[dict[str, Any]] = [{"text": text}]
    if json is not None:
        content.append({"json": json})
    return Answer(status="error", content=content)


_LATE = frozenset(
    {
        Code.EXPIRED,
        Code.STALE,
        Code.NO_OBSERVATION,
        Code.NO_ANSWER,
        Code.TIMEOUT,
        Code.UNREACHABLE,
        Code.PUBLISH,
    }
)
"""Codes of refusals after a missed deadline."""
_REFUSAL_KEYS = ("verb", "code", "reason", "remedy", "offered", "limit", "because")


def refused(refusal: Refused) -> Answer:
    """Return the error envelope of a refusal.

    If a deadline was missed while this computer is busy, the text includes the computer's load.
    """
    if refusal.code in _LATE or refusal.because == Reason.EXPIRED:
        refusal = busy.with_load(refusal)
    details = {key: str(value) for key in _REFUSAL_KEYS if (value := getattr(refusal, key))}
    return error(refusal.text, {"refused": details})


def with_remedy(answer: Answer, remedies: Mapping[str, str]) -> Answer:
    """Return a refusal with another remedy. Interfaces that have other verbs use it.

    Args:
        answer: Any envelope. An envelope that is not a refusal is returned unchanged.
        remedies: The new remedy by code of the refusal. Refusals with other codes are unchanged.
    """
    fields = answer["content"][-1].get("json", {}).get("refused", {})
    remedy = remedies.get(fields.get("code", ""))
    if remedy is None or "reason" not in fields:
        return answer
    return refused(refusals.with_remedy(fields, remedy))


def stop_result(verb: str, result: StopResult, done: dict[str, Any] | None = None) -> Answer:
    """Return the envelope (answer) for a stop. It is a success only if every motor confirmed the safe state.

    Args:
        verb: The verb, for the text of an error.
        result: The result of the stop.
        done: Values that the verb adds to the JSON, by key.
    """
    more = done or {}
    match result:
        case Confirmed(proof):
            match proof:
                case NothingRan(reason):
                    return success({"stopped": True, "reason": reason, **more})
                case StopReport():
                    return success({**_report(proof), **more})
                case _:
                    assert_never(proof)
        case Unconfirmed(report):
            named = ", ".join(f"{motor.axis} (id {motor.id}): {motor.detail}" for motor in result.unsafe)
            text = f"{verb}: not confirmed by {named or 'the robot'}. Cut its power if it still moves"
            return error(text, {**more, **_report(report)})
        case Unreachable(refusal, motors):
            refused = {"code": str(refusal.code)}
            json = {**more, "stopped": False, "unconfirmed": list(motors), "refused": refused}
            return error(result.text, json)
        case _:
            assert_never(result)


def warn_unless_safe(robot: str, answer: Answer) -> None:
    """Log a cleanup that failed, since the program does not see the result of the cleanup."""
    if answer["status"] != "success":
        _log.warning("%s: %s", robot, answer["content"][0]["text"])


def _report(report: StopReport) -> dict[str, Any]:
    return {
        "stopped": report.confirmed,
        "reason": str(report.reason),
        "safe_state": str(report.safe_state),
        "path": report.path,
        "took_ms": round(report.took_ms, 2),
        "unconfirmed": report.unconfirmed,
        "note": report.note,
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


def task(status: TaskStatus) -> dict[str, Any]:
    """Return the values that ``get_task_status`` reports, by key."""
    return {
        "running": status.running,
        "steps": status.steps,
        "elapsed_s": round(status.elapsed_s, 3),
        "exit_reason": status.exit_reason or None,
        "exit_detail": status.exit_detail or None,
        "refusal": status.refusal or None,
        "instruction": status.instruction,
        "hz": round(status.hz, 2),
        **({"teleop": status.teleop} if status.teleop else {}),
    }


def status(
    tool_name: str,
    robot: str,
    driver: Driver,
    problem: str,
    gate_status: Status | None,
    facts: Mapping[str, Any],
    standby_report: str | None = None,
) -> dict[str, Any]:
    """Return the values that ``get_status`` reports, by key. The keys are the same if the robot does not answer.

    Args:
        tool_name: Name of the handle.
        robot: Name of the robot.
        driver: Driver of the robot.
        problem: Why the robot does not answer.
        gate_status: The status from the gate, which checks every command; None if the gate did not answer.
        facts: Facts that the robot reported when it was opened (``Wire.open``). They replace equal keys.
        standby_report: Report of the standby process (the last one that can stop the robot) of an earlier run.
    """
    observation = None if gate_status is None else gate_status.observation
    return {
        "tool_name": tool_name,
        "robot": robot,
        "connected": gate_status is not None and gate_status.connected,
        "connect_error": problem if gate_status is None else gate_status.connect_error or None,
        "state": UNREACHABLE if gate_status is None else gate_status.mode,
        "epoch": None if gate_status is None else gate_status.epoch,
        "locked_by": None if gate_status is None else gate_status.locked_by or None,
        "locked_since": None if gate_status is None else gate_status.locked_since or None,
        "cause": None if gate_status is None else gate_status.cause or None,
        "last_stop_cause": None if gate_status is None else gate_status.last_stop_cause or None,
        "lease": None if gate_status is None else gate_status.holder or None,
        "observation_age_s": None if gate_status is None or gate_status.age_s < 0 else round(gate_status.age_s, 4),
        "writes": 0 if gate_status is None else gate_status.writes,
        "reads": 0 if gate_status is None else gate_status.reads,
        "refusals": 0 if gate_status is None else gate_status.refusals,
        "last_refusal": None if gate_status is None else gate_status.last_refusal or None,
        "standby": None if gate_status is None else gate_status.no_standby or "ready",
        "standby_report": standby_report,
        "motors": dict(zip(driver.axes, driver.ids, strict=True)),
        "faults": {} if observation is None else dict(observation.faults),
        "sensors": {} if observation is None else sensors(observation),
        "fallbacks": {str(reason): str(safe_state) for reason, safe_state in driver.fallbacks.items()},
        "firmware_watchdog": driver.firmware_watchdog,
        "unit": driver.unit,
        **facts,
        **({} if observation is None else driver.readings(observation)),
    }


def positions(driver: Driver, observation: Observation) -> dict[str, float | None]:
    """Return the positions by key, as ``get_observation`` does; null for an axis that was never read."""
    return {key: _none_if_nan(value) for key, value in driver.observed(observation).items()}


def velocities(driver: Driver, observation: Observation) -> dict[str, float | None]:
    """Return the velocities by axis; empty if the robot does not report them."""
    return {axis: _none_if_nan(value) for axis, value in zip(driver.axes, observation.velocity, strict=False)}


def sensors(observation: Observation) -> dict[str, list[float | None]]:
    """Return the sensors by name; null for an unknown value."""
    return {name: [_none_if_nan(value) for value in row] for name, row in observation.sensors.items()}


def _none_if_nan(value: float) -> float | None:
    return None if math.isnan(value) else value


def tree(report: TreeReport) -> dict[str, Any]:
    """Return the processes and actors of one robot, in the form of ``strands-actors tree --json``."""
    return {
        "robot": report.robot,
        "state": report.state,
        "epoch": report.epoch,
        "locked_by": report.locked_by,
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
