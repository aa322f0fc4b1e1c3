"""The envelopes of the drivers page, and an answer that can be used at once or awaited."""

from __future__ import annotations

import logging
import math
import sys
from collections.abc import Coroutine, Generator, Iterator, Mapping
from concurrent.futures import Future
from typing import Any, assert_never

import msgspec

from strands_actors.contract.driver import Driver, Reason
from strands_actors.contract.wire import Observation
from strands_actors.kernel.health import busy
from strands_actors.kernel.messages import Refused
from strands_actors.kernel.refusals import Code
from strands_actors.supervisors.gate.messages import Status, StopReport
from strands_actors.supervisors.root.messages import TaskStatus, TreeReport
from strands_actors.supervisors.stop_result import Confirmed, NothingRan, StopResult, Unconfirmed, Unreachable

_log = logging.getLogger("strands_actors")

UNREACHABLE = "unreachable"
"""The state of a robot that does not answer, or was not connected."""


class Answer(dict[str, Any], Coroutine[Any, Any, "Answer"]):
    """``{"status", "content"}``. Awaiting it gives itself, so ``stop()`` and ``await stop()`` both
    work; to asyncio it is a coroutine, so ``asyncio.run(robot.stop())`` does, too."""

    def __await__(self) -> Generator[Any, None, Answer]:
        yield from ()
        return self

    def send(self, value: Any) -> Any:
        raise StopIteration(self)

    def throw(self, typ: Any, val: Any = None, tb: Any = None) -> Any:
        raise typ

    def close(self) -> None:
        """Nothing is under way."""


class PendingAnswer(Mapping[str, Any], Coroutine[Any, Any, Answer]):
    """What ``stop()`` and ``get_status()`` return inside a running event loop: already under way,
    whether awaited or not, and not cancelled with who awaits it. A coroutine to asyncio: for
    ``await``, ``create_task``, ``gather`` and ``wait_for``, which do not block the loop. To read it
    as a dict waits, which is what a cell of a notebook wants."""

    def __init__(self, future: Future[Answer]) -> None:
        self._future = future
        self._driven: Coroutine[Any, Any, Answer] | None = None

    def __hash__(self) -> int:
        return id(self)  # gather keeps coroutines in a dict

    def __await__(self) -> Generator[Any, Any, Answer]:
        return _when_done(self._future).__await__()

    def send(self, value: Any) -> Any:
        return self._drive().send(value)

    def throw(self, typ: Any, val: Any = None, tb: Any = None) -> Any:
        return self._drive().throw(typ)

    def close(self) -> None:
        """Wait no more. What is under way goes on."""
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
        """True, without waiting: no answer is empty, and asyncio asks when it shows a task (Python
        3.12)."""
        return True

    def __repr__(self) -> str:
        return repr(self._future.result())


async def _when_done(future: Future[Answer]) -> Answer:
    import asyncio  # who awaits this has it

    return await asyncio.shield(asyncio.wrap_future(future))


def in_asyncio() -> bool:
    """Return whether an asyncio loop runs in this thread. Not by an import: who runs one has it,
    and it costs 8 ms."""
    asyncio = sys.modules.get("asyncio")
    return asyncio is not None and asyncio._get_running_loop() is not None


def success(json: dict[str, Any]) -> Answer:
    return Answer(status="success", content=[{"json": json}])


def picture(png: bytes, json: dict[str, Any]) -> Answer:
    """Return a picture as agents take it."""
    image = {"format": "png", "source": {"bytes": png}}
    return Answer(status="success", content=[{"image": image}, {"json": json}])


def error(text: str, json: dict[str, Any] | None = None) -> Answer:
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
"""Codes of refusals after a deadline that was missed."""
_TOLD = ("verb", "code", "reason", "remedy", "offered", "limit", "because")


def refused(refusal: Refused) -> Answer:
    """A missed deadline names a computer that is too busy."""
    if refusal.code in _LATE or refusal.because == Reason.EXPIRED:
        refusal = msgspec.structs.replace(refusal, reason=busy.explained(refusal.reason))
    details = {key: str(value) for key in _TOLD if (value := getattr(refusal, key))}
    return error(refusal.text, {"refused": details})


def with_remedy(answer: Answer, remedies: Mapping[str, str]) -> Answer:
    """Return a refusal with the remedy of somebody else's verbs.

    Args:
        answer: Any envelope; one that is no refusal is returned as it is.
        remedies: What to do, by code of the refusal.
    """
    told = answer["content"][-1].get("json", {}).get("refused", {})
    remedy = remedies.get(told.get("code", ""))
    if remedy is None or "reason" not in told:
        return answer
    return refused(Refused(**{**told, "remedy": remedy}))


def stop_result(verb: str, result: StopResult, done: dict[str, Any] | None = None) -> Answer:
    """A stop is a success only when every motor confirmed it. ``done``: what else the verb answers."""
    more = done or {}
    match result:
        case Confirmed(proof):
            match proof:
                case NothingRan(why):
                    return success({"stopped": True, "reason": why, **more})
                case StopReport():
                    return success({**_report(proof), **more})
                case _:
                    assert_never(proof)
        case Unconfirmed(report):
            named = ", ".join(f"{motor.axis} (id {motor.id}): {motor.detail}" for motor in result.unsafe)
            text = f"{verb}: not confirmed by {named or 'the robot'}. cut its power if it still moves"
            return error(text, {**more, **_report(report)})
        case Unreachable(refusal, motors):
            refused = {"code": str(refusal.code)}
            json = {**more, "stopped": False, "unconfirmed": list(motors), "refused": refused}
            return error(result.text, json)
        case _:
            assert_never(result)


def warn_unless_safe(robot: str, answer: Answer) -> None:
    """Log a cleanup that nobody reads the answer of, unless it is a success."""
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
    told: Status | None,
    facts: Mapping[str, Any],
    standby_report: str | None = None,
) -> dict[str, Any]:
    """The same keys whether the robot answers or not. ``problem``: why it does not. ``facts``: what
    its wire said of itself when it last answered; they come on top. ``standby_report``: of an
    earlier tree's standby."""
    observation = None if told is None else told.observation
    return {
        "tool_name": tool_name,
        "robot": robot,
        "connected": told is not None and told.connected,
        "connect_error": problem if told is None else told.connect_error or None,
        "state": UNREACHABLE if told is None else told.mode,
        "epoch": None if told is None else told.epoch,
        "locked_by": None if told is None else told.locked_by or None,
        "locked_since": None if told is None else told.locked_since or None,
        "cause": None if told is None else told.cause or None,
        "lease": None if told is None else told.holder or None,
        "observation_age_s": None if told is None or told.age_s < 0 else round(told.age_s, 4),
        "writes": 0 if told is None else told.writes,
        "reads": 0 if told is None else told.reads,
        "refusals": 0 if told is None else told.refusals,
        "last_refusal": None if told is None else told.last_refusal or None,
        "standby": None if told is None else told.no_standby or "ready",
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
    """By public key; what was never read is null."""
    return {key: _known(value) for key, value in driver.observed(observation).items()}


def velocities(driver: Driver, observation: Observation) -> dict[str, float | None]:
    """By axis; empty where the robot measures none."""
    return {axis: _known(value) for axis, value in zip(driver.axes, observation.velocity, strict=False)}


def sensors(observation: Observation) -> dict[str, list[float | None]]:
    """By name, in axis order; what is not known is null."""
    return {name: [_known(value) for value in row] for name, row in observation.sensors.items()}


def _known(value: float) -> float | None:
    return None if math.isnan(value) else value


def tree(report: TreeReport) -> dict[str, Any]:
    """As ``strands-actors tree --json`` prints one robot."""
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
