"""A command borrows a free lease of a robot, and always gives it back."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

import pytest
import trio
import trio.testing

from strands_actors.surfaces.cli import borrow as module
from strands_actors.surfaces.cli.borrow import borrow


@pytest.fixture
def releases(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """The robot's answers to a release; without any, it does not answer."""
    answers: list[Any] = []

    @asynccontextmanager
    async def reach(robot: str, configuration: object) -> AsyncIterator[object]:
        yield object()

    async def release(tree: object) -> Any:
        if not answers:
            await trio.sleep_forever()
        return answers[0]

    monkeypatch.setattr(module, "reach", reach)
    monkeypatch.setattr(module.verbs, "release", release)
    return answers


def used(why: str) -> str:
    async def use(tree: object) -> str:
        await trio.lowlevel.checkpoint()
        return why

    return trio.run(borrow, "so101", None, use, clock=trio.testing.MockClock(autojump_threshold=0))


def test_the_command_reports_why_the_use_or_the_release_failed(releases: list[Any]) -> None:
    releases.append({"status": "success", "content": []})
    assert used("") == "" and used("it is e-stopped") == "it is e-stopped"
    releases[0] = {"status": "error", "content": [{"text": "release: not confirmed"}]}
    assert used("") == "release: not confirmed" and used("it is e-stopped") == "it is e-stopped"


def test_saf_023_a_release_without_an_answer_is_not_a_success(releases: list[Any]) -> None:
    assert used("") == "release: no answer" and used("it is e-stopped") == "it is e-stopped"
