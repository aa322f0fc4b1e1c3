"""``stop()`` and ``get_status()`` for a program of asyncio: coroutines, that read as dicts all the
same."""

from __future__ import annotations

import asyncio
import gc
import inspect
import json
import time
import warnings
from concurrent.futures import Future
from typing import Any

import pytest

from strands_actors.caller.handle.envelopes import Answer, PendingAnswer, success
from strands_actors.caller.handle.robot import RealRobot
from strands_actors.testing import Twin
from tests.answers import json_of, until

from .helpers import limps, moves

Awaited = Any
"""An answer, as a script has it: a dict and a coroutine."""


def test_asyncio_runs_what_a_verb_returns(arm: RealRobot, twin: Twin) -> None:
    told: Awaited = arm.get_status()
    assert json_of(asyncio.run(told)) == json_of(told)
    stopping: Awaited = arm.stop()
    assert json_of(asyncio.run(stopping))["stopped"] is True
    assert limps(twin.log)


def test_tasks_gather_and_a_deadline_take_what_a_verb_returns(arm: RealRobot) -> None:
    async def main() -> list[Any]:
        told: list[Awaited] = [arm.get_status() for _ in range(4)]
        task = asyncio.create_task(told[0])
        both = await asyncio.gather(told[1], arm.stop())  # type: ignore[arg-type]
        return [await task, *both, await asyncio.wait_for(told[2], 5.0), await told[3]]

    for answer in asyncio.run(main()):
        assert type(answer) is Answer
        assert answer["status"] == "success", answer


def test_a_stop_that_nobody_awaits_is_sent_and_nobody_is_warned(arm: RealRobot, twin: Twin) -> None:
    moves(arm)
    began_ns = time.monotonic_ns()

    async def main() -> None:
        arm.stop()

    with warnings.catch_warnings():
        warnings.simplefilter("error")
        asyncio.run(main())
        gc.collect()
    until(lambda: limps(twin.log, began_ns), "it is stopped")


def test_saf_002_a_stop_goes_on_when_who_awaits_it_gives_up(arm: RealRobot, twin: Twin) -> None:
    moves(arm)
    began_ns = time.monotonic_ns()

    async def main() -> None:
        task: asyncio.Task[Any] = asyncio.create_task(arm.stop())  # type: ignore[arg-type]
        await asyncio.sleep(0)
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task

    asyncio.run(main())
    until(lambda: limps(twin.log, began_ns), "it is stopped")
    assert until(lambda: json_of(arm.get_status())["state"] == "disarmed", "that is known")


# -- without a robot


def test_an_answer_is_a_dict_and_a_coroutine() -> None:
    answer = success({"a": 1})
    assert isinstance(answer, dict)
    assert json.loads(json.dumps(answer)) == answer
    assert asyncio.iscoroutine(answer)
    assert inspect.isawaitable(answer)
    assert asyncio.run(answer) is answer
    answer.close()


def test_what_is_under_way_reads_as_a_dict_once_it_is_done() -> None:
    future: Future[Answer] = Future()
    pending = PendingAnswer(future)
    assert asyncio.iscoroutine(pending)
    future.set_result(success({"a": 1}))
    assert dict(pending) == success({"a": 1})
    assert asyncio.run(pending) == success({"a": 1})
    pending.close()


def test_a_task_that_waits_for_it_is_shown_without_waiting() -> None:
    """Python 3.12 asks a task's coroutine whether it is true, which waited for a mapping's length."""

    async def shown() -> str:
        future: Future[Answer] = Future()
        future.set_exception(OSError("who looks at the answer is told"))
        pending = PendingAnswer(future)
        assert pending
        task = asyncio.create_task(pending)  # type: ignore[arg-type]
        text = repr(task)
        with pytest.raises(OSError, match="is told"):
            await task
        return text

    assert "PendingAnswer" in asyncio.run(shown())


def test_a_failure_is_raised_where_it_is_awaited() -> None:
    future: Future[Answer] = Future()
    future.set_exception(OSError("gone"))
    with pytest.raises(OSError, match="gone"):
        asyncio.run(PendingAnswer(future))
