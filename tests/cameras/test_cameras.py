"""Cameras of an arm on a twin. Each has a separate process, and no other process waits for it."""

from __future__ import annotations

import contextlib
import math
import os
import signal
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import trio

from strands_actors import Robot, open_robot
from strands_actors.caller.handle.robot import RealRobot
from strands_actors.kernel.health.processor import is_stopped
from strands_actors.surfaces.cameras import CameraReader, Frame, Stale, StaleFrame, attach_camera
from strands_actors.surfaces.cameras.picture_files import cameras_of, pictures_dir
from strands_actors.testing import WireLog
from tests.answers import json_of, pids, status, task, task_ended

from .looking import PATIENCE_S, until

SMALL = {"fps": 20, "width": 48, "height": 32}
OWN = "tests.cameras.sources:"

NewArm = Callable[..., RealRobot]


@pytest.fixture
def new_arm(run_dir: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[NewArm]:
    """Make an arm with these cameras, on a twin whose wire log is ``run_dir / "wire"``."""
    monkeypatch.setenv("STRANDS_ACTORS_TWIN_LOG", str(run_dir / "wire"))
    made: list[RealRobot] = []

    def new(cameras: dict[str, Any], **keywords: Any) -> RealRobot:
        made.append(Robot("so101", **{"mode": "real", "transport": "twin", **keywords}, cameras=cameras))
        assert made[-1].connect_eagerly() is None
        return made[-1]

    yield new
    for arm in made:
        arm.cleanup()
    with pytest.raises(FileNotFoundError):
        pictures_dir()  # no pictures are left


def pid_of(arm: RealRobot, camera: str) -> int:
    return pids(arm).get(f"camera/{camera}", 0)


def picture(reader: CameraReader) -> Frame:
    return until(lambda: frame if isinstance(frame := reader.newest(), Frame) else None, "a picture")


def told(arm: RealRobot, camera: str) -> dict[str, Any]:
    found: dict[str, Any] = status(arm)["cameras"][camera]
    return found


def test_the_scene_of_a_twin_is_seen_from_the_wrist_and_from_the_front(new_arm: NewArm) -> None:
    size = {"fps": 5, "width": 64, "height": 48}
    arm = new_arm({"wrist": size, "front": {**size, "rotation": 90, "width": 48, "height": 64}})

    def both() -> dict[str, Any] | None:
        seen = arm.get_observation(images=True)
        return seen if all(isinstance(seen[name], Frame) for name in ("wrist", "front")) else None

    seen = until(both, "both pictures")
    assert {"shoulder_pan", "gripper"} < set(seen)
    assert seen["wrist"].image.shape == (48, 64, 3)
    assert seen["front"].image.shape == (64, 48, 3)
    before = seen["wrist"]
    assert before.image.std() > 5, "the picture is not uniform"
    json_of(arm.send_action({"shoulder_pan": 60.0}))

    def moved() -> bool:
        now = arm.read_camera("wrist", max_age_ms=60_000)
        return bool(abs(now.image.astype(int) - before.image).mean() > 3)

    until(moved, "it moves along")
    for name in ("wrist", "front"):
        found = told(arm, name)
        assert (found["state"], found["opened"], found["why"]) == ("streaming", 1, None)


def test_a_simulation_shows_an_added_object(run_dir: Path) -> None:
    with Robot("so101", cameras={"top": {"fps": 5, "width": 64, "height": 48}}) as sim:
        before = picture(attach_camera("so101", "top"))
        json_of(sim.add_object("box", size=[0.3, 0.3, 0.3], position=[0.2, 0.3, 0.15], color=[1, 0, 0]))

        def red() -> bool:
            now = sim.read_camera("top", max_age_ms=60_000).image.astype(int) - before.image
            return bool((now[:, :, 0] - now[:, :, 2] > 60).sum() > 20)

        until(red, "a red box")


def test_a_reader_never_waits_and_never_gets_an_old_picture(new_arm: NewArm) -> None:
    arm = new_arm({"eye": {"type": OWN + "once", **SMALL}})
    reader = attach_camera("so101", "eye")
    until(lambda: reader.sequence, "its one picture")
    until(lambda: isinstance(reader.newest(), Stale), "it grows old")
    began_s = time.monotonic()
    stale = reader.newest()
    seen = arm.get_observation(images=True)
    assert time.monotonic() - began_s < 1.0
    assert isinstance(stale, Stale)
    assert stale.sequence == 1 and stale.age_s is not None and stale.age_s > 0.2
    assert "ms old, more than 200" in stale.why
    assert isinstance(seen["eye"], Stale)
    with pytest.raises(StaleFrame, match=r"camera 'eye': the newest picture is .* ms old") as refusal:
        arm.read_camera("eye")
    assert isinstance(refusal.value.stale, Stale)
    # A caller that allows old pictures gets this one.
    assert arm.read_camera("eye", max_age_ms=60_000).sequence == 1
    assert told(arm, "eye")["stale"]
    with pytest.raises(ValueError, match=r"no camera 'ear'\. there are eye"):
        arm.read_camera("ear")
    until(lambda: "took more than 5 s" in (told(arm, "eye")["why"] or ""), "what gives nothing is given up")
    until(lambda: reader.sequence > 1, "and another process opens it anew")


def test_an_unplugged_camera_is_reported_and_opened_again(new_arm: NewArm, run_dir: Path) -> None:
    plug = run_dir / "plug"
    arm = new_arm({"eye": {"type": OWN + "plugged", "view": str(plug), **SMALL}})
    until(lambda: told(arm, "eye")["why"] == "it is not plugged in", "it is not there yet")
    assert isinstance(arm.get_observation(images=True)["eye"], Stale)
    plug.touch()
    reader = attach_camera("so101", "eye")
    first = picture(reader)
    pid = pid_of(arm, "eye")
    plug.unlink()
    until(lambda: told(arm, "eye")["why"] in ("it was unplugged", "it is not plugged in"), "it is told")
    until(lambda: isinstance(reader.newest(), Stale), "and not shown any more")
    plug.touch()
    again = picture(reader)
    assert again.sequence > first.sequence
    assert pid_of(arm, "eye") == pid, "the same process opens the camera again"
    assert told(arm, "eye")["opened"] >= 2


def test_the_fault_of_a_camera_is_reported_by_name(new_arm: NewArm) -> None:
    arm = new_arm(
        {
            "wide": {"type": OWN + "wide", **SMALL},
            "broken": {"type": OWN + "broken", **SMALL},
            "nowhere": {"type": OWN + "nobody", **SMALL},
            "ahead": {"type": OWN + "ahead", **SMALL},
        }
    )
    until(lambda: told(arm, "wide")["state"] == "refused", "another size is refused")
    assert "it gives 80 x 40, and 48 x 32 is asked for" in told(arm, "wide")["why"]
    until(lambda: told(arm, "broken")["why"] == "ZeroDivisionError: of a user's own code", "and told")
    until(lambda: "has no attribute 'nobody'" in (told(arm, "nowhere")["why"] or ""), "there is no such source")
    until(lambda: "Use Python's time.monotonic_ns" in (told(arm, "ahead")["why"] or ""), "another clock's")
    with pytest.raises(StaleFrame, match="there is no picture yet"):
        arm.read_camera("ahead", 60_000)
    assert status(arm)["state"] == "armed"


def test_a_reader_follows_a_restarted_robot_and_names_a_missing_camera(new_arm: NewArm) -> None:
    with pytest.raises(ConnectionError, match="no robot 'so101' with cameras runs here"):
        attach_camera("so101", "eye")
    arm = new_arm({"eye": {"type": OWN + "steady", **SMALL}})
    with pytest.raises(ConnectionError, match=r"has no camera 'ear'\. there are eye"):
        attach_camera("so101", "ear")
    reader = attach_camera("so101", "eye")
    picture(reader)
    for wrong in ("50", [50], -1, 0, float("nan"), float("inf"), True):
        with pytest.raises(ValueError, match="Give milliseconds, above 0"):
            arm.read_camera("eye", wrong)  # type: ignore[arg-type]
        with pytest.raises(ValueError, match="Give seconds, above 0"):
            reader.newest(wrong)  # type: ignore[arg-type]
    none: tuple[Any, ...] = (["eye"], {}, None)
    for nothing in none:
        with pytest.raises(ValueError, match=r"no camera .*\. there are eye"):
            arm.read_camera(nothing)
    arm.read_camera("eye", 1e308)
    arm.cleanup()
    assert cameras_of("so101") == []
    until(lambda: isinstance(reader.newest(), Stale), "it has ended")
    until(lambda: "no camera 'eye' of so101 runs" in getattr(reader.newest(), "why", ""), "and that is known")
    assert isinstance(arm.get_observation(images=True).get("eye"), Stale)
    new_arm({"eye": {"type": OWN + "steady", **SMALL}})
    picture(reader)
    reader.close()
    assert reader.newest() == Stale("this reader was closed")


async def _asynchronously() -> tuple[dict[str, Any], Frame, Frame | Stale]:
    turned = {"type": OWN + "steady", "fps": 20, "width": 32, "height": 48, "rotation": 180, "color_mode": "bgr"}
    async with open_robot("so101", mode="real", transport="twin", cameras={"eye": turned}) as arm:
        with trio.fail_after(PATIENCE_S):
            while not isinstance((seen := await arm.get_observation(images=True))["eye"], Frame):  # noqa: ASYNC110
                await trio.sleep(0.03)
        with attach_camera("so101", "eye") as reader:
            return seen, await arm.read_camera("eye", 60_000), reader.newest(60.0)


def test_cameras_in_a_trio_program_and_a_bgr_picture(run_dir: Path) -> None:
    seen, frame, of_others = trio.run(_asynchronously)
    assert {"gripper", "eye"} < set(seen)
    assert frame.image.shape == (48, 32, 3)
    assert frame.image[-1, -1].tolist()[0] == 200  # the corner of the rotated picture
    assert isinstance(of_others, Frame)
    assert of_others.image[-1, -1].tolist()[2] == 200, "other readers get RGB"


# -- cameras do not disturb the robot


def wave(observation: dict[str, float]) -> dict[str, float]:
    return {"shoulder_pan": 5.0 * math.sin(2 * time.monotonic())}


@pytest.mark.long
def test_saf_001_003_a_killed_or_frozen_camera_does_not_disturb_setpoints(new_arm: NewArm, run_dir: Path) -> None:
    """SAF-001, SAF-003: while setpoints are streamed at 50 Hz, one camera is killed, and another, which
    floods, is frozen. No setpoint exceeds its lifetime (the robot would hold), and a stop is as quick as
    without cameras."""
    arm = new_arm({"eye": {"type": OWN + "steady", **SMALL}, "flood": {"type": OWN + "flood", **SMALL}})
    log = WireLog(run_dir / "wire")
    eye = attach_camera("so101", "eye")
    picture(eye)
    picture(attach_camera("so101", "flood"))
    first, frozen = pid_of(arm, "eye"), pid_of(arm, "flood")
    json_of(arm.run_policy(wave, n_steps=200, control_frequency=50.0))
    began_ns = time.monotonic_ns()
    until(lambda: len(log.host("setpoint", began_ns)) > 20 or not task(arm)["running"], "it streams")
    os.kill(first, signal.SIGKILL)
    until(lambda: pid_of(arm, "eye") not in (0, first), "it is started again")
    os.kill(frozen, signal.SIGSTOP)
    until(lambda: is_stopped(frozen), "it is frozen")
    ended = task_ended(arm)
    assert ended["exit_reason"] == "n_steps", str(ended)
    stream = [entry for entry in log.entries(began_ns) if entry.sender == "host" and entry.kind != "read"]
    last_ns = max(entry.t_ns for entry in stream if entry.kind == "setpoint")
    assert not [entry for entry in stream if entry.kind == "safe" and entry.t_ns < last_ns], "the arm did not hold"
    stopped_ns = time.monotonic_ns()
    json_of(arm.stop())
    log.safe_within(stopped_ns, 0.5)
    log.no_setpoint_after_safe(stopped_ns)
    picture(eye)
    until(lambda: pid_of(arm, "flood") not in (0, frozen), "who is frozen is replaced")


def test_saf_015_a_camera_has_nothing_of_the_robot_open_and_ends_with_it(new_arm: NewArm) -> None:
    """SAF-015: a camera has no descriptor of the wire and no socket of another process, only its own
    pictures. It ends when its root is killed."""
    arm = new_arm({"eye": {"type": OWN + "steady", **SMALL}})
    picture(attach_camera("so101", "eye"))
    pid = pid_of(arm, "eye")
    kinds = open_of(pid)
    pictures = [kind for kind in kinds if kind.endswith(".pictures")]
    assert len(pictures) == 1, kinds
    assert not [kind for kind in kinds if kind.startswith(("/dev/tty", "/dev/pts/")) and kind not in streams(pid)]
    assert not [kind for kind in kinds if kind.endswith(".lock")], kinds
    tree = arm.tree()
    assert tree is not None
    for process in tree["processes"]:
        if process["pid"] != pid:
            theirs = open_of(process["pid"])
            assert not {kind for kind in kinds if kind.startswith("socket:")} & theirs, process
    os.kill(pids(arm)["root"], signal.SIGKILL)
    until(lambda: not Path(f"/proc/{pid}").exists(), "it has ended")


def open_of(pid: int) -> set[str]:
    found = set()
    for entry in Path(f"/proc/{pid}/fd").iterdir():
        with contextlib.suppress(FileNotFoundError):  # closed meanwhile
            found.add(os.readlink(entry))
    return found


def streams(pid: int) -> set[str]:
    """Return the standard streams of a process. They may be the terminal of the test run."""
    return {os.readlink(f"/proc/{pid}/fd/{number}") for number in (0, 1, 2)}
