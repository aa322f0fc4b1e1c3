"""The operator gate: who may, who is asked, and what counts as a yes."""

from __future__ import annotations

import os
import pty
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import trio

from strands_actors import Robot
from strands_actors.kernel.messages import Refused
from strands_actors.kernel.processes.guard import ALLOW
from strands_actors.surfaces.agents import approval as gate
from strands_actors.surfaces.agents.approval import Approval, Approve, Request

MOVE = Request("so101", "move_to", {"targets": {"gripper": 3}})


@pytest.fixture(autouse=True)
def nothing_allowed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(ALLOW, raising=False)


def ask(approval: Approval, request: Request = MOVE, keys: tuple[str, ...] = ()) -> Refused | None:
    return trio.run(lambda: approval.refuse(request, keys))


def guarded(approve: Approve | None = None, within_s: float = 20.0) -> Approval:
    return Approval(("move_to", "takeoff"), approve, within_s)


def never(request: Request) -> bool:
    pytest.fail(f"asked: {request}")


def raises(request: Request) -> bool:
    raise PermissionError("not on my watch")


def test_what_is_not_guarded_is_not_asked_about() -> None:
    assert ask(Approval((), never)) is None
    assert ask(guarded(never), Request("so101", "sensors"), ("gripper",)) is None


def test_a_guarded_verb_and_a_guarded_key_are_asked_about() -> None:
    asked: list[Request] = []
    approval = guarded(lambda request: asked.append(request) is None)
    assert ask(approval) is None
    fly = Request("drone", "action", {"takeoff": 1.0}, "mesh")
    assert ask(approval, fly, ("takeoff",)) is None
    assert ask(approval, fly, ("takeoff.pos",)) is None
    assert asked == [MOVE, fly, fly]


@pytest.mark.parametrize(
    ("approve", "why"),
    [
        (None, "there is nobody to ask"),
        (lambda request: False, "it was not given"),
        (lambda request: None, "it was not given"),
        (lambda request: "yes", "it was not given"),
        (lambda request: 1, "it was not given"),
        (raises, "asking failed with PermissionError: not on my watch"),
    ],
)
def test_only_true_is_a_yes(approve: Any, why: str) -> None:
    refusal = ask(guarded(approve))
    assert refusal is not None
    assert (refusal.code, refusal.offered) == ("not_approved", "move_to")
    assert why in refusal.text
    assert ALLOW in refusal.remedy


@pytest.mark.parametrize("keywords", [{"guarded": "move_to"}, {"guarded": ("stop",)}, {"approve": True}])
def test_what_would_guard_nothing_is_refused(keywords: dict[str, Any]) -> None:
    with pytest.raises((TypeError, ValueError), match=r"guarded|approve"):
        Robot("so101", mode="real", port="/dev/nowhere", **keywords)


def test_no_answer_in_time_is_a_no() -> None:
    released = threading.Event()
    refusal = ask(guarded(lambda request: released.wait(20.0), within_s=0.05))
    released.set()
    assert refusal is not None
    assert "no answer within 0.05 s" in refusal.text


def test_the_environment_allows_without_asking(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(ALLOW, "move_to, ,land")
    assert ask(guarded(never)) is None
    refusal = ask(guarded(), MOVE, ("takeoff",))
    assert refusal is not None
    assert refusal.offered == "takeoff"


@pytest.fixture
def operator(monkeypatch: pytest.MonkeyPatch) -> Any:
    """A terminal, and what a person at it answers when the prompt is there."""
    near, far = pty.openpty()
    monkeypatch.setattr(gate, "TERMINAL", Path(os.ttyname(far)))

    def answer(line: str) -> Callable[[], str]:
        prompts: list[str] = []

        def sit() -> None:
            shown = b""
            while b"[y/N]" not in shown:
                shown += os.read(near, 1000)
            prompts.append(shown.decode())
            os.write(near, line.encode())

        thread = threading.Thread(target=sit)
        thread.start()

        def prompt() -> str:
            thread.join(20.0)
            return prompts[0]

        return prompt

    yield answer
    os.close(near)
    os.close(far)


@pytest.mark.parametrize(("line", "yes"), [("y\n", True), ("YES\n", True), ("\n", False), ("yesterday\n", False)])
def test_a_person_is_asked_on_the_terminal(operator: Any, line: str, yes: bool) -> None:
    prompt = operator(line)
    assert gate.ask_on_terminal(MOVE) is yes
    assert "agent asks so101: move_to targets={'gripper': 3}. allow? [y/N]" in prompt()


def test_without_a_terminal_it_is_a_no(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gate, "TERMINAL", Path("/nowhere"))
    refusal = ask(guarded(gate.ask_on_terminal))
    assert refusal is not None
    assert "asking failed with FileNotFoundError" in refusal.text
