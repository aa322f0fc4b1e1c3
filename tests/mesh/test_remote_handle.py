"""``Robot(..., at=)`` drives a robot of another host with the same handle, over TLS and a simulated cable."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pytest

from strands_actors import Robot
from strands_actors.caller.handle.robot import RealRobot
from strands_actors.surfaces.mesh import MeshConfig
from strands_actors.surfaces.mesh.keys import make
from strands_actors.testing import Twin
from tests.answers import json_of, pids, state, until, why
from tests.ports import free_port
from tests.trees import first_safe

from .proxy import Cable
from .world import tls

LIFETIME_S = 0.6
"""Tolerance on the lifetime, for a busy machine. The measured bound is 50 ms."""


class Hosts(NamedTuple):
    here: RealRobot  # the handle that started the robot
    there: RealRobot
    twin: Twin
    cable: Cable
    keys: Path


@pytest.fixture
def hosts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, run_dir: Path) -> Iterator[Hosts]:
    """Yield a robot with a free lease, and a handle on it from another host."""
    keys = tmp_path / "keys"
    make(keys, robots=["so101"])
    port = free_port()
    with Twin("so101", tmp_path) as twin, Cable(port) as cable:
        config = MeshConfig(listen=f"tls/127.0.0.1:{port}", tls=tls(keys, "so101"))
        here = Robot("so101", mode="real", port=twin.port, mesh=config)
        elsewhere = run_dir / "elsewhere"
        elsewhere.mkdir(mode=0o700)
        there = far(keys, cable)
        try:
            assert here.connect_eagerly() is None
            json_of(here.release())
            monkeypatch.setenv("STRANDS_ACTORS_RUN", str(elsewhere))
            yield Hosts(here, there, twin, cable, keys)
        finally:
            there.cleanup()
            here.cleanup()


def far(keys: Path, cable: Cable, role: str = "operator", **keywords: object) -> RealRobot:
    mesh = MeshConfig(tls=tls(keys, role))
    at = f"tls/localhost:{cable.port}"
    return Robot("so101", mode="real", at=at, mesh=mesh, lifetime=LIFETIME_S, **keywords)


def waving(arm: RealRobot, pid: list[int]) -> object:
    """Return a policy that appends the pid of its process to ``pid``."""
    start, count = arm.get_observation()["wrist_roll"], iter(range(10_000))

    def policy(observation: dict[str, float]) -> dict[str, float]:
        pid.append(os.getpid())
        return {"wrist_roll": start + 0.3 * (next(count) % 20)}

    return policy


def test_a_robot_of_another_host_has_the_same_verbs(hosts: Hosts) -> None:
    here, there, twin, _, _ = hosts
    assert "not connected" in why(there.send_action({"shoulder_pan": 0.0}))  # to connect would resume it
    assert there.connect_eagerly() is None
    seen = there.get_observation()
    assert set(seen) == set(there.driver.axes)
    began_ns = time.monotonic_ns()
    commanded = json_of(there.send_action({"wrist_roll": seen["wrist_roll"] + 5.0}))
    assert commanded["commanded"] == {"wrist_roll": pytest.approx(seen["wrist_roll"] + 5.0, abs=0.2)}
    until(lambda: bool(twin.log.host("setpoint", began_ns)), "it is on the wire")
    assert "elbow" in why(there.send_action({"elbow": 1.0}))
    x, y, z = json_of(there.get_pose())["xyz"]
    assert json_of(there.move_to(xyz=(x, y, z)))["pose"]["xyz"] == pytest.approx([x, y, z], abs=1e-3)
    assert "out of reach" in why(there.move_to(xyz=(2.0, 0.0, 0.0)))
    assert "(operator.caller." in why(here.send_action({"wrist_roll": 0.0})), "one writer at a time"
    assert there.is_connected
    assert pids(there).keys() >= {"root", "wire"}

    stopped_ns = time.monotonic_ns()
    assert json_of(there.stop())["stopped"]
    first_safe(twin.log, stopped_ns)
    assert "resume()" in why(there.send_action({"wrist_roll": 0.0}))
    json_of(there.resume())
    json_of(there.send_action({"wrist_roll": there.get_observation()["wrist_roll"]}))
    json_of(there.release())
    json_of(here.send_action({"wrist_roll": here.get_observation()["wrist_roll"]}))
    assert json_of(there.cleanup())["stopped"]
    assert state(here) == "armed", "cleanup must not stop a robot that another writer commands"


def test_cleanup_of_a_remote_handle_stops_its_own_motion_and_ends_no_tree(hosts: Hosts) -> None:
    here, there, twin, cable, keys = hosts
    assert there.connect_eagerly() is None
    json_of(there.send_action({"wrist_roll": there.get_observation()["wrist_roll"]}))
    ended_ns = time.monotonic_ns()
    assert json_of(there.cleanup())["stopped"]
    first_safe(twin.log, ended_ns)
    assert state(here) == "disarmed"
    again = far(keys, cable)
    assert again.connect_eagerly() is None
    json_of(again.send_action({"wrist_roll": again.get_observation()["wrist_roll"]}))
    again.cleanup()


def test_a_policy_runs_on_the_callers_host_and_leaves_the_robot_held(hosts: Hosts) -> None:
    _, there, twin, _, _ = hosts
    assert there.connect_eagerly() is None
    pids: list[int] = []
    began_ns = time.monotonic_ns()
    json_of(there.run_policy(waving(there, pids), duration=1.0))
    assert "stop_task()" in why(there.send_action({"wrist_roll": 0.0}))
    until(lambda: not json_of(there.get_task_status())["running"], "it is over")
    task = json_of(there.get_task_status())
    assert (task["exit_reason"], set(pids)) == ("duration", {os.getpid()})
    assert len(twin.log.host("setpoint", began_ns)) > 10
    json_of(there.send_action({"wrist_roll": there.get_observation()["wrist_roll"]}))
    json_of(there.start_task("wave", policy_provider="sine", duration=60.0))
    until(lambda: json_of(there.get_task_status())["steps"] > 5, "a named one, too")
    json_of(there.stop_task())
    assert state(there) == "holding"


def test_saf_001_a_cut_cable_leads_to_a_hold_within_the_lifetime_and_an_unanswered_stop_is_not_confirmed(
    hosts: Hosts,
) -> None:
    here, there, twin, cable, _ = hosts
    assert there.connect_eagerly() is None
    json_of(there.run_policy(waving(there, []), duration=60.0))
    until(lambda: len(twin.log.host("setpoint")) > 20, "it moves")
    cut_ns = time.monotonic_ns()
    cable.cut()
    safe = until(lambda: twin.log.first_safe(cut_ns), "a safe frame")
    took_s = (safe.t_ns - cut_ns) / 1e9
    print(f"held {1e3 * took_s:.0f} ms after the cut, with a lifetime of {1e3 * LIFETIME_S:.0f} ms")
    assert state(here) == "holding"

    refusal = why(there.stop())
    assert "does not answer" in refusal and "not known" in refusal
    assert "move:" in why(there.send_action({"wrist_roll": 0.0}))
    assert there.get_observation() == {}
    assert state(there) == "unreachable"

    cable.heal()
    until(lambda: state(there) == "holding", "it is reached again")
    assert twin.log.setpoints_after_safe(cut_ns) == 0
    assert "Resume" in why(there.send_action({"wrist_roll": 0.0}))
    assert twin.log.setpoints_after_safe(cut_ns) == 0
    json_of(there.resume())
    json_of(there.send_action({"wrist_roll": there.get_observation()["wrist_roll"]}))


def test_an_unanswered_cleanup_is_not_a_success(hosts: Hosts) -> None:
    _, there, _, cable, _ = hosts
    assert there.connect_eagerly() is None
    cable.cut()
    refusal = why(there.cleanup())
    assert "does not answer" in refusal
    assert "cleaned up" in why(there.send_action({"wrist_roll": 0.0}))


@pytest.mark.long
def test_a_viewer_gets_no_handle_and_a_missing_robot_is_named(hosts: Hosts) -> None:
    _, _, twin, cable, keys = hosts
    viewer, stranger = far(keys, cable, "viewer"), far(keys, cable, tool_name="nobody")
    for robot, named in ((viewer, "so101"), (stranger, "nobody")):
        problem = robot.connect_eagerly()
        assert problem is not None and f"{named} at tls/localhost" in problem and "operator" in problem
        robot.cleanup()
    assert not twin.log.host("setpoint")


def test_a_remote_handle_refuses_options_of_the_hardware_and_unsafe_connections(tmp_path: Path) -> None:
    with pytest.raises(TypeError, match="port="):
        Robot("so101", mode="real", at="tcp/127.0.0.1:1", port="/dev/null", mesh=MeshConfig(insecure=True))
    with pytest.raises(ValueError, match="needs certificates"):
        Robot("so101", mode="real", at="tls/arm.example:7447")
    with pytest.raises(ValueError, match="insecure"):
        Robot("so101", mode="real", at="tcp/192.0.2.7:7447")
    with pytest.raises(ValueError, match="lifetime"):
        Robot("so101", mode="real", at="tcp/127.0.0.1:1", lifetime=60.0, mesh=MeshConfig(insecure=True))
    with pytest.raises(TypeError, match="at="):
        Robot("so101", at="tcp/127.0.0.1:1", mesh=MeshConfig(insecure=True))
