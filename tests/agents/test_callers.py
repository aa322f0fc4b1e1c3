"""Call a robot from asyncio loops, notebooks and trio programs, before, while and after it is connected."""

from __future__ import annotations

import asyncio
import json
import os
import signal
import time
from typing import Any

import pytest
import trio

from strands_actors import open_robot
from strands_actors.caller.handle.robot import RealRobot
from strands_actors.caller.session.portal import portal
from strands_actors.testing import Twin
from tests.answers import json_of, pids, state, status, task_ended, until, why
from tests.robot.conftest import NewArm
from tests.robot.helpers import at, limps

CLEANED_UP = "this robot was cleaned up. Make a new one"

Observed = dict[str, float]


def ahead(observation: Observed) -> dict[str, float]:
    return {"shoulder_pan": observation["shoulder_pan"] + 0.5}


# -- asyncio and notebooks


def in_a_loop(verb: Any) -> Any:
    """Call the verb as a notebook's cell does: in the main thread, inside a running loop."""

    async def cell() -> Any:
        return verb()

    return asyncio.run(cell())


def test_every_synchronous_verb_works_in_a_notebook(twin: Twin, new_arm: NewArm) -> None:
    arm = new_arm(port=twin.port)
    assert in_a_loop(arm.connect_eagerly) is None
    json_of(in_a_loop(lambda: arm.send_action({"shoulder_pan": 10.0})))
    assert in_a_loop(lambda: arm.get_observation())
    json_of(in_a_loop(lambda: arm.run_policy(ahead, n_steps=3)))
    assert task_ended(arm)["steps"] == 3
    json_of(in_a_loop(arm.stop_task))
    assert in_a_loop(lambda: arm.get_status()["content"][0]["json"]["connected"]) is True  # without await
    stopped = in_a_loop(lambda: dict(arm.stop()))
    assert json_of(stopped)["unconfirmed"] == []
    json_of(in_a_loop(arm.resume))
    json_of(in_a_loop(arm.cleanup))
    assert why(in_a_loop(lambda: dict(arm.stop()))) == f"stop: {CLEANED_UP}"


def test_a_pending_answer_reads_like_the_answer(arm: RealRobot) -> None:
    async def cell() -> None:
        pending = arm.stop()
        assert len(pending) == 2
        assert sorted(pending) == ["content", "status"]
        assert pending["status"] == "success"
        assert repr(pending) == repr(await pending)
        assert await pending is await pending

    asyncio.run(cell())


def test_a_cancelled_wait_cancels_neither_the_stop_nor_the_portal(arm: RealRobot, twin: Twin) -> None:
    twin.fault("off:3")  # so that the stop is slow
    until(lambda: "elbow_flex" in status(arm)["faults"], "servo 3 is noticed")
    began_ns = time.monotonic_ns()

    async def impatient() -> None:
        for verb in (arm.get_status, arm.stop):
            with pytest.raises(asyncio.TimeoutError):
                await asyncio.wait_for(verb(), 1e-9)  # type: ignore[arg-type]

    asyncio.run(impatient())
    until(lambda: limps(twin.log, began_ns), "it is stopped all the same")
    until(lambda: state(arm) in ("disarmed", "unconfirmed"), "every motor was tried")
    twin.fault("ok")
    until(lambda: state(arm) == "disarmed", "nothing keeps its tree, which ends with the test")


def test_a_cancelled_future_ends_its_call() -> None:
    begun, ended = trio.Event(), []

    async def long() -> None:
        begun.set()
        try:
            await trio.sleep_forever()
        finally:
            ended.append(True)

    future = portal().submit(long)
    portal().call(begun.wait)
    assert future.cancel()
    until(lambda: ended, "it was cancelled")
    assert portal().call(trio.lowlevel.checkpoint) is None  # the loop still works


# -- one shape of status


def test_status_has_the_same_keys_in_every_state(twin: Twin, new_arm: NewArm) -> None:
    arm = new_arm(port=twin.port)
    before = status(arm)
    assert (before["state"], before["connected"], before["epoch"]) == ("unreachable", False, None)
    assert arm.connect_eagerly() is None
    live = status(arm)
    assert set(before) <= set(live)
    assert live["connect_error"] is None
    json.dumps(live)
    victims = [pids(arm)[role] for role in ("root", "wire")]
    for pid in victims:
        os.kill(pid, signal.SIGSTOP)
    try:
        frozen = status(arm)
    finally:
        for pid in victims:
            os.kill(pid, signal.SIGCONT)
    assert set(frozen) == set(live)
    assert (frozen["state"], frozen["connected"]) == ("unreachable", False)
    assert frozen["connect_error"] == "the process that talks to the robot does not answer"
    arm.cleanup()
    after = status(arm)
    assert set(before) == set(after)
    assert after["connect_error"] == CLEANED_UP


# -- trio


def test_a_trio_program_has_every_verb(twin: Twin) -> None:
    async def main() -> None:
        async with open_robot("so101", mode="real", port=twin.port) as robot:
            assert (robot.tool_name, robot.name, robot.tool_spec["name"]) == ("so101",) * 3
            moved = json_of(await robot.send_action({"shoulder_pan": 10.0}))
            assert moved == {"commanded": {"shoulder_pan": 10.0}, "unit": "degrees (gripper: percent open)"}
            assert "past 110.1" in why(await robot.send_action({"shoulder_pan": 400.0}))
            assert "shoulder_pan" in await robot.get_observation()
            json_of(await robot.run_policy(ahead, n_steps=3))
            async for _ in robot.observations(hz=100):
                if not (result := json_of(await robot.get_task_status()))["running"]:
                    break
            assert result["steps"] == 3
            assert "duration is 0" in why(await robot.run_policy(ahead, duration=0))
            assert "no policy" in why(await robot.run_policy(3))
            assert "lerobot" in why(await robot.start_task("wave"))
            json_of(await robot.start_task("wave", policy_provider="mock"))
            assert json_of(await robot.stop_task())["running"] is False
            assert json_of(await robot.get_status())["state"] in ("armed", "holding")
            assert json_of(await robot.stop())["unconfirmed"] == []
            on = {"action": "set_torque", "enabled": True}
            assert "needs an operator's approval" in why(await robot.use_tool(on, "test"))
            json_of(await robot.resume())
            with pytest.raises(ValueError, match="hz is 0"):
                robot.observations(hz=0)
        assert "cleaned up" in why(await robot.send_action({"shoulder_pan": 0.0}))

    trio.run(main)
    assert limps(twin.log)


def test_a_trio_program_can_watch_without_energising(twin: Twin) -> None:
    async def main() -> Observed:
        async with open_robot("so101", mode="real", port=twin.port, arm=False) as robot:
            assert json_of(await robot.get_status())["state"] == "disarmed"
            assert "resume() first" in why(await robot.send_action({"shoulder_pan": 0.0}))
            async for observation in robot.observations(hz=50):
                return observation
        raise AssertionError

    assert "gripper" in trio.run(main)
    assert not twin.log.host("enable")


def test_the_arm_reaches_its_target(arm: RealRobot) -> None:
    json_of(in_a_loop(lambda: arm.send_action({"wrist_roll": -15.0})))
    at(arm, "wrist_roll", -15.0)
