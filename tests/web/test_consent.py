"""A program asks the operators of the console for an approval."""

from __future__ import annotations

import subprocess
import sys
import threading
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

from strands_actors.surfaces.agents.approval import Request
from strands_actors.surfaces.agents.asking import ask_on_console
from tests.cli.command import Command

from .browser import OpenPage, Visitor
from .serving import console_of

ASK = """
from strands_actors import ask_on_console
from strands_actors.surfaces.agents.approval import Request
ask_on_console(Request("so101", "set_torque", {"enabled": True}))
"""


@pytest.fixture
def operator(tmp_path: Path, cli: Command, monkeypatch: pytest.MonkeyPatch) -> Iterator[Visitor]:
    """Give an operator. The test itself uses the console's run directory."""
    monkeypatch.setenv("STRANDS_ACTORS_RUN", cli.environment["STRANDS_ACTORS_RUN"])
    with console_of(cli) as facts, Visitor(facts["url"]) as visitor:
        yield visitor


@pytest.fixture
def ask() -> Iterator[Any]:
    with ThreadPoolExecutor() as threads:

        def start(within_s: float = 20.0) -> Future[bool]:
            inputs = {"targets": {"gripper": 3.0}, "seconds": 1}
            return threads.submit(ask_on_console, Request("so101", "move_to", inputs, "agent", within_s))

        yield start


def card_of(page: OpenPage, state: str) -> dict[str, Any]:
    message = page.until(
        lambda message: message["type"] == "consent" and state in [card["state"] for card in message["cards"]],
        f"a card that is {state}",
    )
    card: dict[str, Any] = next(card for card in message["cards"] if card["state"] == state)
    return card


@pytest.mark.parametrize("approve", [True, False])
def test_the_first_of_two_operators_decides(operator: Visitor, ask: Any, approve: bool) -> None:
    with operator.page() as first, operator.page() as second:
        asking = ask()
        card = card_of(first, "waiting")
        assert (card["robot"], card["verb"], card["by"]) == ("so101", "move_to", "agent")
        assert card["inputs"] == {"targets": "{'gripper': 3.0}", "seconds": "1"} and 0 < card["left_s"] <= 20
        card_of(second, "waiting")
        path, statuses = f"/consent/{card['id']}", []

        def answer() -> None:
            statuses.append(operator.http.post(path, json={"approve": approve}).status_code)

        both = [threading.Thread(target=answer) for _ in range(2)]
        for one in both:
            one.start()
        for one in both:
            one.join()
        assert sorted(statuses) == [200, 409]
        assert asking.result(20) is approve
        ended = card_of(second, "approved" if approve else "refused")
        assert ended["answered_by"].startswith("console ")


def test_a_question_without_an_answer_ends_as_refused(operator: Visitor, ask: Any) -> None:
    with operator.page() as page:
        asking = ask(0.5)
        number = card_of(page, "timed out")["id"]
        with pytest.raises(TimeoutError, match="no operator has answered"):
            asking.result(20)
        late = operator.http.post(f"/consent/{number}", json={"approve": True})
        assert late.status_code == 409 and "timed out already" in late.text
    assert operator.http.post("/consent/999", json={"approve": True}).status_code == 404


def test_the_question_of_a_killed_program_is_withdrawn(operator: Visitor) -> None:
    with operator.page() as page:
        program = subprocess.Popen([sys.executable, "-c", ASK])
        card_of(page, "waiting")
        program.kill()
        program.wait()
        card_of(page, "withdrawn")


def test_without_a_console_nothing_is_approved(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("STRANDS_ACTORS_RUN", str(tmp_path / "run"))
    with pytest.raises(ConnectionError, match="strands-actors web"):
        ask_on_console(Request("so101", "move_to"))
