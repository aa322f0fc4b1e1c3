"""``stop()`` and ``get_status()`` return coroutines for asyncio programs, which can also be read as dicts."""

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
"""An answer as a script gets it: a dict and a coroutine."""


def test_asyncio_can_run_the_answer_of_a_verb(arm: RealRobot, twin: Twin) -> None:
    reported: Awaited = arm.get_status()
    assert json_of(asyncio.run(reported)) == json_of(reported)
    stopping: Awaited = arm.stop()
    assert json_of(asyncio.run(stopping))["stopped"] is True
    assert limps(twin.log)


def test_tasks_gather_and_wait_for_accept_the_answer_of_a_verb(arm: RealRobot) -> None:
    async def main() -> list[Any]:
        statuses: list[Awaited] = [arm.get_status() for _ in range(4)]
        task = asyncio.create_task(statuses[0])
        both = await asyncio.gather(statuses[1], arm.stop())  # type: ignore[arg-type]
        return [await task, *both, await asyncio.wait_for(statuses[2], 5.0), await statuses[3]]

    for answer in asyncio.run(main()):
        assert type(answer) is Answer
        assert answer["status"] == "success", answer


def test_a_stop_that_is_not_awaited_is_sent_without_a_warning(arm: RealRobot, twin: Twin) -> None:
    moves(arm)
    began_ns = time.monotonic_ns()

    async def main() -> None:
        arm.stop()

    with warnings.catch_warnings():
        warnings.simplefilter("error")
        asyncio.run(main())
        gc.collect()
    until(lambda: limps(twin.log, began_ns), "the arm is limp")


def test_saf_002_a_stop_continues_when_its_await_is_cancelled(arm: RealRobot, twin: Twin) -> None:
    moves(arm)
    began_ns = time.monotonic_ns()

    async def main() -> None:
        task: asyncio.Task[Any] = asyncio.create_task(arm.stop())  # type: ignore[arg-type]
        await asyncio.sleep(0)
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task

    asyncio.run(main())
    until(lambda: limps(twin.log, began_ns), "the arm is limp")
    assert until(lambda: json_of(arm.get_status())["state"] == "disarmed", "the status shows it")


# -- without a robot


def test_an_answer_is_a_dict_and_a_coroutine() -> None:
    answer = success({"a": 1})
    assert isinstance(answer, dict)
    assert json.loads(json.dumps(answer)) == answer
    assert asyncio.iscoroutine(answer)
    assert inspect.isawaitable(answer)
    assert asyncio.run(answer) is answer
    answer.close()


def test_a_pending_answer_can_be_read_as_a_dict_when_it_is_done() -> None:
    future: Future[Answer] = Future()
    pending = PendingAnswer(future)
    assert asyncio.iscoroutine(pending)
    future.set_result(success({"a": 1}))
    assert dict(pending) == success({"a": 1})
    assert asyncio.run(pending) == success({"a": 1})
    pending.close()


def test_the_repr_of_a_task_does_not_wait_for_its_answer() -> None:
    """Python 3.12 tests the truth of a task's coroutine, which for a mapping would wait for its length."""

    async def shown() -> str:
        future: Future[Answer] = Future()
        future.set_exception(OSError("the answer failed"))
        pending = PendingAnswer(future)
        assert pending
        task = asyncio.create_task(pending)  # type: ignore[arg-type]
        text = repr(task)
        with pytest.raises(OSError, match="failed"):
            await task
        return text

    assert "PendingAnswer" in asyncio.run(shown())


def test_a_failure_is_raised_where_it_is_awaited() -> None:
    future: Future[Answer] = Future()
    future.set_exception(OSError("gone"))
    with pytest.raises(OSError, match="gone"):
        asyncio.run(PendingAnswer(future))
