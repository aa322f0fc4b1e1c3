"""SAF-017: a policy process has only the rights of its channel, whatever its frames contain. The tests
read the simulated robot's wire log.
"""

from __future__ import annotations

import os
import time
from typing import Any

import pytest

from strands_actors.caller.handle.robot import RealRobot
from strands_actors.caller.processes import directory
from strands_actors.caller.session.portal import portal
from strands_actors.contract.driver import Reason
from strands_actors.kernel.actor import Actor
from strands_actors.kernel.messages import Message, Refused
from strands_actors.kernel.node import Node
from strands_actors.supervisors import addresses
from strands_actors.supervisors.gate.gate import Gate
from strands_actors.supervisors.gate.messages import SafeDone, StopReport
from strands_actors.supervisors.root.guardian import Guardian
from strands_actors.supervisors.root.messages import StateIs
from strands_actors.surfaces.mesh import estop
from strands_actors.testing import Twin
from tests.answers import json_of, pids, state, status, task_ended, until

from .helpers import COUNTS_PER_DEGREE, IDS, at, goals, limps
from .hostile import FAR, Hostile

LONG_S = 60.0
BOUND_S = 1.0
"""Much longer than the published bound, because the machine may be busy."""
LOOK_S = 1.0
"""Seconds in which a hostile policy makes a dozen attempts."""


def attack(arm: RealRobot, how: str, **options: Any) -> None:
    """Start a hostile policy while the arm is far from ``FAR``. Wait until it sends setpoints and its
    attack has begun.
    """
    json_of(arm.send_action({"shoulder_pan": 0.0}))
    at(arm, "shoulder_pan", 0.0)
    where = f"{Hostile.__module__}:{Hostile.__qualname__}"
    json_of(arm.start_task("attack", policy_provider=where, duration=LONG_S, how=how, **options))
    until(lambda: json_of(arm.get_task_status())["steps"] > 5, "the policy writes")
    time.sleep(0.2)


def farthest(twin: Twin, since_ns: int) -> float:
    """Return the goal of the base joint on the wire that is farthest from the middle, in degrees."""
    seen = [goals(entry).get(IDS["shoulder_pan"]) for entry in twin.log.host("setpoint", since_ns)]
    return max((abs(goal - 2048) / COUNTS_PER_DEGREE for goal in seen if goal is not None), default=0.0)


def enabled(twin: Twin, since_ns: int) -> list[bytes]:
    return [entry.data for entry in twin.log.host("enable", since_ns)]


def test_saf_017_an_estop_is_answered_by_the_wire_and_not_by_a_policy_that_claims_the_gates_address(
    arm: RealRobot, twin: Twin
) -> None:
    attack(arm, "gate")
    pid = pids(arm).get("policy")
    assert pid is not None
    began_ns = time.monotonic_ns()
    (outcome,) = estop(by="the button", within_s=5.0)
    assert outcome.outcome == "safe", outcome
    assert len(outcome.motors) == len(IDS), "the forged report names no motor"
    twin.log.safe_within(began_ns, BOUND_S)
    assert limps(twin.log, began_ns)
    time.sleep(LOOK_S)
    twin.log.no_setpoint_after_safe(began_ns)
    assert status(arm)["locked_by"] == "the button"


def test_saf_017_a_tree_ends_safely_although_a_policy_claims_the_gates_address(arm: RealRobot, twin: Twin) -> None:
    attack(arm, "gate")
    began_ns = time.monotonic_ns()
    answer = json_of(arm.cleanup())
    assert answer["unconfirmed"] == []
    assert len(answer["motors"]) == len(IDS)
    assert limps(twin.log, began_ns)
    twin.log.no_setpoint_after_safe(began_ns)


def test_saf_017_a_policy_lifts_no_stop_and_takes_no_lease(arm: RealRobot, twin: Twin) -> None:
    json_of(arm.send_action({"shoulder_pan": 0.0}))  # so that it has a lease
    at(arm, "shoulder_pan", 0.0)
    assert arm._tree is not None and arm._tree._writer.lease is not None
    started_ns = time.monotonic_ns()
    attack(arm, "resume", holder=f"so101 in process {os.getpid()}", lease=arm._tree._writer.lease.id)
    began_ns = time.monotonic_ns()
    json_of(arm.stop())
    time.sleep(LOOK_S)
    assert state(arm) == "disarmed"
    assert not enabled(twin, began_ns)
    twin.log.no_setpoint_after_safe(began_ns)
    assert farthest(twin, started_ns) < FAR / 2
    json_of(arm.resume())
    json_of(arm.send_action({"shoulder_pan": 5.0}))


def test_saf_017_a_policy_writes_nothing_past_the_gate(arm: RealRobot, twin: Twin) -> None:
    attack(arm, "write")
    began_ns = time.monotonic_ns()
    time.sleep(LOOK_S)
    assert 0.0 < farthest(twin, began_ns) < FAR / 2


def test_saf_017_an_estop_ends_the_policy_process(arm: RealRobot) -> None:
    attack(arm, "stay")
    pid = pids(arm).get("policy")
    assert pid is not None
    (outcome,) = estop(by="the button", within_s=5.0)
    assert outcome.outcome == "safe"
    until(lambda: not os.path.exists(f"/proc/{pid}"), "the policy's process has ended")
    ended = task_ended(arm)
    assert ended["exit_reason"] == "stop", ended


def test_a_named_policy_may_do_all_that_a_policy_needs(arm: RealRobot, twin: Twin) -> None:
    """It sends setpoints, ends, and leaves the robot in a hold."""
    began_ns = time.monotonic_ns()
    json_of(arm.start_task("wave", policy_provider="sine", duration=0.5))
    ended = task_ended(arm)
    assert ended["exit_reason"] == "duration", ended
    assert len(twin.log.host("setpoint", began_ns)) > 5
    json_of(arm.send_action({"shoulder_pan": 5.0}))


def ask(node: Node, to: str, actor: type[Actor], message: Message) -> Message | None:
    async def run() -> Message | None:
        return await node.ref(to, actor).ask(message, 5.0)

    return portal().call(run)


@pytest.mark.usefixtures("arm")
def test_saf_017_the_wires_reports_count_only_over_its_own_link() -> None:
    """They are refused from the tree's caller and from programs on this user's mesh."""
    addresses_of_tree = addresses.of("so101")
    forged = SafeDone(StopReport(Reason.STOP, "limp", 99, True, ()))

    async def as_visitor() -> list[Message | None]:
        async with directory.join() as joined:
            await joined.tree(joined.notes[0])
            reports = (
                (addresses_of_tree.guardian, Guardian, StateIs("disarmed", 99, "", "forged")),
                (addresses_of_tree.gate, Gate, forged),
            )
            return [await joined._ask(to, actor, message, 5.0) for to, actor, message in reports]

    answers = portal().call(as_visitor)
    answers.append(ask(portal().node, addresses_of_tree.guardian, Guardian, StateIs("disarmed", 99, "", "forged")))
    answers.append(ask(portal().node, addresses_of_tree.gate, Gate, forged))
    assert [answer.code for answer in answers if isinstance(answer, Refused)] == ["channel"] * 4
