"""Operators talk with the agent of the console."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from typing import Any

import pytest

from strands_actors.surfaces.cli import run
from tests.cli.command import Command

from .browser import OpenPage, Visitor
from .serving import console_of
from .test_consent import card_of


@contextlib.contextmanager
def talking(cli: Command, factory: str) -> Iterator[tuple[Visitor, OpenPage]]:
    agent = f"tests.web.scripted_agent:{factory}"
    with console_of(cli, "--agent", agent) as facts, Visitor(facts["url"]) as visitor, visitor.page() as page:
        yield visitor, page


def entry(page: OpenPage, kind: str, tool: str = "") -> dict[str, Any]:
    def entries(message: dict[str, Any]) -> list[dict[str, Any]]:
        every = message["entries"] if message["type"] == "agent" else []
        return [each for each in every if (each["kind"], each["tool"]) == (kind, tool)]

    found = page.until(lambda message: bool(entries(message)), f"an entry {kind} {tool}")
    return entries(found)[0]


def test_an_agent_asks_gets_and_is_refused_before_everybodys_eyes(cli: Command) -> None:
    with talking(cli, "helpful") as (visitor, page):
        visitor.order("/agent/say", text="let one wave")
        assert entry(page, "prompt")["text"] == "let one wave"
        assert '"list"' in entry(page, "asks", "fleet")["text"]
        assert '"robots":[]' in entry(page, "got", "fleet")["text"].replace(" ", "")
        card = card_of(page, "waiting")
        assert (card["verb"], card["robot"]) == ("run", "so101")
        assert visitor.http.post("/agent/say", json={"text": "more"}).status_code == 409
        visitor.order(f"/consent/{card['id']}", approve=False)
        assert "needs an operator's approval" in entry(page, "refused", "fleet")["text"]
        assert entry(page, "text")["text"] == "that is all"
        entry(page, "done")
        with visitor.page() as second:  # A page that comes later gets all of it.
            assert [each["kind"] for each in second.kind("agent")["entries"]][:3] == ["prompt", "ready", "asks"]


def test_a_stopped_agent_ends_and_starts_anew(cli: Command) -> None:
    with talking(cli, "slow") as (visitor, page):
        for _ in range(2):
            visitor.order("/agent/say", text="hello")
            page.messages.clear()
            entry(page, "ready")
            visitor.order("/agent/stop")
            entry(page, "ended")
            page.messages.clear()
        assert visitor.http.post("/agent/stop").status_code == 409


def test_an_agent_that_cannot_be_made_says_why(cli: Command) -> None:
    with talking(cli, "broken") as (visitor, page):
        visitor.order("/agent/say", text="hello")
        assert "RuntimeError: no key" in entry(page, "failed")["text"]
        entry(page, "ended")


def test_without_an_agent_nothing_runs(shared_visitor: Visitor) -> None:
    answer = shared_visitor.http.post("/agent/say", json={"text": "hello"})
    assert answer.status_code == 409 and "--agent" in answer.text


@pytest.mark.parametrize("factory", ["nowhere.at.all:make", "json"])
def test_a_wrong_agent_is_refused_at_the_start(factory: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["web", "--port", "0", "--agent", factory]) == 2
    assert f"--agent {factory}" in capsys.readouterr().err
