"""The access and the limits of the process of a named policy."""

from __future__ import annotations

import contextlib
import json
import os
import pwd
import tempfile
from pathlib import Path
from typing import Any

import pytest

from strands_actors import Robot
from strands_actors.caller.handle.robot import RealRobot
from strands_actors.kernel.processes.limits import PolicyLimits, limits_of
from strands_actors.surfaces.mesh import TLS, MeshConfig, estop
from strands_actors.surfaces.mesh.keys import make
from strands_actors.testing import Twin
from tests.answers import json_of, task_ended
from tests.trees import begin_moving

from .curious import Curious
from .helpers import at, limps

WHERE = f"{Curious.__module__}:{Curious.__qualname__}"
SECRET = "so101.key"


def look(robot: RealRobot, into: Path, **options: Any) -> dict[str, Any]:
    json_of(robot.start_task("look", policy_provider=WHERE, duration=0.3, into=str(into), secret=SECRET, **options))
    ended = task_ended(robot)
    assert ended["exit_reason"] == "duration", ended
    report: dict[str, Any] = json.loads(into.read_text())
    return report


def sockets_of_the_tree(robot: RealRobot) -> set[str]:
    """Return the sockets and terminals of the tree's processes. The arm's port is a terminal."""
    tree = robot.tree()
    assert tree is not None
    report = set()
    for process in tree["processes"]:
        for fd in os.listdir(f"/proc/{process['pid']}/fd"):
            with contextlib.suppress(OSError):
                report.add(os.readlink(f"/proc/{process['pid']}/fd/{fd}"))
    return {target for target in report if target.startswith(("socket:", "/dev/pts"))}


def test_saf_017_a_policy_process_has_no_descriptor_no_link_and_no_key_of_others(
    twin: Twin, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    make(tmp_path / "keys", robots=["so101"])
    keys = TLS(*(str(tmp_path / "keys" / name) for name in ("ca.pem", "so101.pem", SECRET)))
    monkeypatch.setenv("STRANDS_ACTORS_MESH", str(tmp_path / "mesh.toml"))
    (tmp_path / "mesh.toml").write_text("")
    with Robot("so101", mode="real", port=twin.port, mesh=MeshConfig(listen="tls/127.0.0.1:0", tls=keys)) as arm:
        json_of(arm.send_action({"shoulder_pan": 0.0}))
        # The policy sends what it observes. While the joint still moved, this would be a jump from the target.
        at(arm, "shoulder_pan", 0.0)
        others = sockets_of_the_tree(arm)
        report = look(arm, tmp_path / "found.json")
    targets = report["descriptors"]
    beyond = {fd: target for fd, target in targets.items() if int(fd) > 2}
    assert len(others) > 5 and not others & set(beyond.values())
    kinds = ("socket:", "anon_inode:", "pipe:", "closed", "/proc")
    assert not [target for target in beyond.values() if not target.startswith(kinds)], targets
    assert "STRANDS_ACTORS_MESH" not in report["environment"]
    assert report["secrets"] == []


def test_limits_are_applied_before_the_policy_is_made(twin: Twin, tmp_path: Path) -> None:
    limits = {"memory_mb": 4096, "cpu_s": 60, "processors": 1}
    with Robot("so101", mode="real", port=twin.port, policy_limits=limits) as arm:
        report = look(arm, tmp_path / "found.json")
        assert (report["memory"], report["cpu"], report["processors"]) == (4096 << 20, 60, 1)
        json_of(
            arm.start_task(
                "eat",
                policy_provider=WHERE,
                duration=5.0,
                into=str(tmp_path / "again.json"),
                secret=SECRET,
                eat_mb=8192,
            )
        )
        ended = task_ended(arm)
        assert ended["exit_reason"] == "policy" and "MemoryError" in ended["exit_detail"], ended
        json_of(arm.stop())
    assert limps(twin.log, 0)


def test_saf_017_a_policy_that_runs_as_another_user_cannot_regain_its_rights(twin: Twin) -> None:
    nobody = pwd.getpwnam("nobody")
    if os.getuid() != 0:
        with pytest.raises(ValueError, match="only root"):
            Robot("so101", mode="real", port=twin.port, policy_limits={"user": "nobody"})
        return
    with (
        tempfile.TemporaryDirectory() as place,
        Robot("so101", mode="real", port=twin.port, policy_limits={"user": "nobody"}) as arm,
    ):
        os.chmod(place, 0o777)
        into = Path(place) / "found.json"
        report = look(arm, into)
        assert (report["uid"], report["can_be_root"]) == (nobody.pw_uid, False)
        assert 0 not in report["groups"]
        assert report["environment"]["USER"] == "nobody"
        begin_moving(
            arm,
            lambda: arm.start_task("on", policy_provider=WHERE, duration=60.0, into=str(into), secret=SECRET),
            lambda progress, _: progress["steps"] > 3,
        )
        (outcome,) = estop(by="the button", within_s=5.0)
        assert outcome.outcome == "safe"
        assert task_ended(arm)["exit_reason"] == "stop"


@pytest.mark.parametrize(
    ("limits", "message"),
    [
        ({"memory": 100}, "memory_mb, cpu_s, processors, user"),
        ({"memory_mb": 1}, "memory_mb"),
        ({"processors": 0}, "processors"),
        ({"user": "nobody at all"}, "no user 'nobody at all'"),
        (7, "policy_limits"),
    ],
)
def test_invalid_limits_are_refused(limits: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        limits_of(limits)
    with pytest.raises(ValueError, match=message):
        Robot("so101", policy_limits=limits)


def test_running_a_policy_as_another_user_needs_the_permission(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "getuid", lambda: 4711)
    monkeypatch.setattr(os, "geteuid", lambda: 4711)
    monkeypatch.setattr("strands_actors.kernel.processes.limits._may_be_others", lambda: False)
    with pytest.raises(ValueError, match="only root can run a policy as 'nobody'"):
        PolicyLimits(user="nobody").check()


def test_policy_limits_are_refused_for_a_robot_on_another_host() -> None:
    with pytest.raises(TypeError, match="policy_limits="):
        Robot(
            "so101", mode="real", at="tcp/192.0.2.7:1", mesh=MeshConfig(insecure=True), policy_limits={"cpu_s": 1}
        )
