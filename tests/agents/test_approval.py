"""The operator's approval: which calls need it, how it is requested, and which answers count as yes."""

from __future__ import annotations

import os
import pty
import threading
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import trio

from strands_actors import Robot
from strands_actors.caller.handle import envelopes as answers
from strands_actors.contract.driver import Driver
from strands_actors.drivers.crazyflie.driver import Crazyflie
from strands_actors.drivers.feetech.driver import Feetech
from strands_actors.drivers.microduck.driver import Microduck
from strands_actors.drivers.robotiq.driver import Robotiq
from strands_actors.drivers.sim.driver import SimDriver
from strands_actors.drivers.spot.driver import Spot
from strands_actors.kernel.messages import Refused
from strands_actors.kernel.processes.guard import ALLOW
from strands_actors.surfaces.agents import approval as gate
from strands_actors.surfaces.agents.approval import Approval, Approve, Request, approval_of
from strands_actors.surfaces.agents.calls import Call, read
from strands_actors.surfaces.agents.use import _in_its_verbs, use
from tests.answers import why

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


def test_an_unguarded_call_needs_no_approval() -> None:
    assert ask(Approval((), never)) is None
    assert ask(guarded(never), Request("so101", "sensors"), ("gripper",)) is None


def test_a_guarded_verb_and_a_guarded_key_need_approval() -> None:
    requests: list[Request] = []
    approval = guarded(lambda request: requests.append(request) is None)
    assert ask(approval) is None
    fly = Request("drone", "action", {"takeoff": 1.0}, "mesh")
    assert ask(approval, fly, ("takeoff",)) is None
    assert ask(approval, fly, ("takeoff.pos",)) is None
    assert requests == [MOVE, fly, fly]


@pytest.mark.parametrize(
    ("approve", "message"),
    [
        (None, "no operator can be asked"),
        (lambda request: False, "it was not given"),
        (lambda request: None, "it was not given"),
        (lambda request: "yes", "it was not given"),
        (lambda request: 1, "it was not given"),
        (raises, "asking failed with PermissionError: not on my watch"),
    ],
)
def test_only_true_counts_as_yes(approve: Any, message: str) -> None:
    refusal = ask(guarded(approve))
    assert refusal is not None
    assert (refusal.code, refusal.offered) == ("not_approved", "move_to")
    assert message in refusal.text
    assert ALLOW in refusal.remedy


@pytest.mark.parametrize(
    "keywords", [{"guarded": "move_to"}, {"guarded": ("stop",)}, {"guarded": 5}, {"approve": True}]
)
def test_an_approval_that_guards_nothing_is_refused(keywords: dict[str, Any]) -> None:
    with pytest.raises((TypeError, ValueError), match=r"guarded|approve"):
        Robot("so101", mode="real", port="/dev/nowhere", **keywords)


@pytest.mark.parametrize("seconds", ["30", None, float("nan"), float("inf"), -1, 0, [1], True])
def test_how_long_an_operator_may_think_is_a_number_of_seconds(seconds: Any) -> None:
    """With another value the tool would raise when it asks the operator."""
    with pytest.raises(ValueError, match=r"approve_within_s is .*\. Give seconds, a number above 0"):
        Robot("so101", mode="real", port="/dev/nowhere", approve_within_s=seconds)


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("set_torqu", "(do you mean set_torque?)"),
        ("send_action", "(do you mean move_to?)"),
        ("move", "(do you mean move_to?)"),
        ("resume", "(do you mean set_torque?)"),
        ("status", "There are move_to, set_torque"),
        ("Gripper", "(do you mean gripper?)"),
    ],
)
def test_a_name_that_guards_nothing_is_refused_with_those_there_are(name: str, expected: str) -> None:
    with pytest.raises(ValueError, match=f"guarded names '{name}', which guards nothing") as refusal:
        Robot("so101", mode="real", port="/dev/nowhere", guarded=("move_to", name))
    assert expected in str(refusal.value)


def test_verbs_axes_and_services_can_be_guarded() -> None:
    arm = approval_of(Feetech, ("set_torque", "gripper.pos"), never, 1.0)
    assert arm.guarded == {"set_torque", "gripper"}
    assert approval_of(Crazyflie, ("takeoff",), never, 1.0).guarded >= {"takeoff"}
    assert "stand" in approval_of(Spot, ("stand",), never, 1.0).guarded
    with pytest.raises(ValueError, match="land, which is a stop"):
        approval_of(Crazyflie, ("land",), never, 1.0)


@pytest.mark.parametrize(
    ("driver_class", "robot", "given"),
    [
        (Spot, "spot", {"action": "stand"}),
        (Microduck, "microduck", {"action": "disable"}),
        (Microduck, "microduck", {"action": "reboot_motors", "confirm": True}),
    ],
)
def test_switching_motor_power_needs_an_approval(
    driver_class: type[Driver], robot: str, given: dict[str, Any]
) -> None:
    tree: Any = SimpleNamespace(robot=robot, driver=driver_class(robot, "", driver_class.resolve(robot, {})))
    call = read(tree.driver, given)
    assert isinstance(call, Call)
    requests: list[Request] = []
    approval = approval_of(driver_class, (given["action"],), lambda request: bool(requests.append(request)), 5.0)
    assert "needs an operator's approval" in why(trio.run(use, tree, call, approval, "agent"))
    assert [request.verb for request in requests] == [given["action"]]
    assert "this tool does not allow motion" in why(trio.run(use, tree, call, Approval(), "mcp", "ask"))


def test_unknown_verb_names_in_an_approval_allow_no_motion() -> None:
    """A simulation has the verbs of its robot, which its class does not know."""

    mistaken = approval_of(SimDriver, ("set_torqu",), never, 1.0)
    tree: Any = SimpleNamespace(robot="so101", driver=Feetech("so101", "", Feetech.resolve("so101", {})))
    call = read(tree.driver, {"action": "move_to", "targets": {"gripper": 1.0}})
    assert isinstance(call, Call)
    assert "move_to: guarded names 'set_torqu'" in why(trio.run(use, tree, call, mistaken, "agent"))


def test_no_answer_in_time_counts_as_no() -> None:
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
    """Simulate a terminal and the answer of a person once the prompt is shown."""
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


def test_without_a_terminal_the_answer_is_no(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gate, "TERMINAL", Path("/nowhere"))
    refusal = ask(guarded(gate.ask_on_terminal))
    assert refusal is not None
    assert "asking failed with FileNotFoundError" in refusal.text


def test_a_tool_without_a_resume_verb_names_the_person_who_must_resume() -> None:
    refused = answers.refused(Refused("disarmed", "the robot is disarmed", "call resume() first", verb="move"))
    gripper = Robotiq("robotiq_2f85", "", Robotiq.resolve("robotiq_2f85", {}))
    assert why(_in_its_verbs(refused, gripper)).endswith("Ask a person to call resume(), which this tool cannot do")
