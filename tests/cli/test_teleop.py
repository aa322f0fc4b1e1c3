"""``teleop`` without a connected leader, and with cameras of the robot that is led."""

from __future__ import annotations

import signal
from typing import Any

import pytest

from strands_actors.surfaces.cameras import Frame, attach_camera
from strands_actors.surfaces.cli import run
from strands_actors.surfaces.cli.options import cameras_of
from tests.answers import until

from .command import PATIENCE_S, Command


def test_a_missing_leader_fails_with_its_full_reason(cli: Command) -> None:
    done = cli.run("teleop", "so101", "--twin", "--from", "so101_leader:/dev/null/arm", "--seconds", "1")
    assert done.returncode == 1, done.stdout + done.stderr
    assert done.stdout == "0 setpoints, 0 frames refused; ended: duration (1 s are over)\n"
    lines = done.stderr.splitlines()
    assert lines[-1].startswith("the leader is not connected: /dev/null/arm: cannot open")
    assert lines[-1].endswith("Check port=, and which program uses it")
    assert len([line for line in lines if line.startswith("idle ")]) <= 3, "one line for each change"


def test_the_cameras_of_a_led_robot_can_be_read_and_recorded(cli: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("STRANDS_ACTORS_RUN", cli.environment["STRANDS_ACTORS_RUN"])
    camera = "eye:view=front,fps=10,width=128,height=96"
    with cli.start("teleop", "so101", "--twin", "--id", "seen", "--camera", camera, "--from", "page") as process:
        try:
            until(lambda: cli.json("tree")["robots"], "it runs", PATIENCE_S)
            # The recorder of datasets attaches to a camera in the same way.
            with attach_camera("seen", "eye") as eye:
                seen = until(
                    lambda: eye.newest() if isinstance(eye.newest(), Frame) else None, "it shows", PATIENCE_S
                )
            assert isinstance(seen, Frame) and seen.image.shape == (96, 128, 3)
        finally:
            process.send_signal(signal.SIGINT)
            process.communicate(timeout=PATIENCE_S)


@pytest.mark.parametrize(
    ("texts", "cameras"),
    [
        ([], None),
        (["wrist"], {"wrist": {}}),
        (["wrist", "front:fps=30"], {"wrist": {}, "front": {"fps": 30}}),
        (
            ["top:index_or_path=/dev/v4l/by-path/pci-0000:00:14.0-usb-0:1:1.0-video-index0,width=640,height=480"],
            {
                "top": {
                    "index_or_path": "/dev/v4l/by-path/pci-0000:00:14.0-usb-0:1:1.0-video-index0",
                    "width": 640,
                    "height": 480,
                }
            },
        ),
        (["a:fourcc=MJPG,warmup_s=0.5"], {"a": {"fourcc": "MJPG", "warmup_s": 0.5}}),
    ],
)  # fmt: skip
def test_a_camera_is_declared_by_its_name_and_its_settings(
    texts: list[str], cameras: dict[str, dict[str, Any]] | None
) -> None:
    assert cameras_of("teleop", texts) == cameras


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["--camera", "wrist:0"], "'0' is not KEY=VALUE. Give NAME, or NAME:index_or_path=0"),
        (["--camera", "wrist", "--camera", "wrist:fps=5"], "two cameras are named wrist"),
        (["--camera", "wrist:fsp=5"], "camera 'wrist' has no setting 'fsp'"),
        (["--camera", "shoulder_pan"], "a camera is named 'shoulder_pan', and so is an axis"),
        (["--id", "my arm"], "id is 'my arm'"),
    ],
)
def test_a_wrong_camera_or_id_is_one_line(
    arguments: list[str], text: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["teleop", "so101", "--twin", "--from", "page", *arguments]) == 2
    error = capsys.readouterr().err
    assert error.startswith("strands-actors: teleop: ") and error.count("\n") == 1 and text in error
