"""A client of Foxglove's protocol sees a running robot through ``strands-actors view --foxglove``."""

from __future__ import annotations

import json
import math
import signal
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from strands_actors.surfaces.cli import run
from strands_actors.surfaces.view.foxglove_sink import FRAMES, JOINTS, LAYOUT, LOG, SCENE
from tests.cli.command import Command, RobotProcess

from .foxglove_client import FoxgloveClient, Message


@contextmanager
def viewed(cli: Command, *arguments: str) -> Iterator[dict[str, Any]]:
    """Run the command, and yield what it prints."""
    with cli.start("view", "so101", "--foxglove", "--port", "0", "--json", *arguments) as process:
        try:
            assert process.stdout is not None and process.stderr is not None
            line = process.stdout.readline()
            assert line, process.stderr.read()
            yield json.loads(line)
            process.terminate()
            assert process.wait(20) == 0
        finally:
            process.kill()


def measured(message: Message) -> dict[str, float]:
    return {joint["name"]: joint["measured"] for joint in message.value["joints"]}


def rotation(message: Message, body: str) -> list[float]:
    """Return the rotation of a body in its parent, as a quaternion. Protobuf leaves zeros out."""
    turn = next(each["rotation"] for each in message.value["transforms"] if each["child_frame_id"] == body)
    return [turn.get(part, 0.0) for part in "wxyz"]


def degrees_between(first: list[float], second: list[float]) -> float:
    cosine = abs(sum(one * other for one, other in zip(first, second, strict=True)))
    return math.degrees(2 * math.acos(min(1.0, cosine)))


def test_joints_frames_and_a_stop_are_seen_in_foxglove(cli: Command, robot: RobotProcess) -> None:
    with viewed(cli) as facts, FoxgloveClient(facts["foxglove"]) as client:
        assert facts["robot"] == "so101" and Path(facts["layout"]).is_file()
        first = client.until(lambda each: each.topic == "/joints", "a reading")
        assert client.info["capabilities"] == []
        assert set(measured(first)) >= {"shoulder_pan", "gripper"} and first.value["state"] == "armed"

        scene = client.until(lambda each: each.topic == "/model", "the model")
        bodies = {entity["frame_id"] for entity in scene.value["entities"]}
        assert bodies >= {"base", "shoulder", "jaw"}
        assert (
            client.schema("/model") == "foxglove.SceneUpdate" and client.schema("/tf") == "foxglove.FrameTransforms"
        )

        frames = client.until(lambda each: each.topic == "/tf", "frames")
        assert {each["child_frame_id"] for each in frames.value["transforms"]} >= bodies
        pan = measured(first)["shoulder_pan"]
        before = rotation(frames, "shoulder")

        assert robot.call("send_action", {"shoulder_pan": 30.0})["status"] == "success"
        commanded = client.until(
            lambda each: (
                each.topic == "/joints"
                and any(
                    (each["name"], each["commanded"]) == ("shoulder_pan", 30.0) for each in each.value["joints"]
                )
            ),
            "the target",
        )
        assert commanded.log_ns >= first.log_ns
        client.until(lambda each: each.topic == "/joints" and measured(each)["shoulder_pan"] > 29, "it moved")
        client.until(
            lambda each: (
                each.topic == "/tf" and abs(degrees_between(rotation(each, "shoulder"), before) - 30 + pan) < 1.5
            ),
            "the frame of the shoulder turned by the measured angle",
        )

        assert robot.call("send_action", {"shoulder_pan": 400.0})["status"] == "error"
        refused = client.until(lambda each: each.value.get("kind") == "refused", "the refusal")
        assert refused.value["code"] == "past_travel" and "past 110" in refused.value["text"]

        assert cli.run("estop", "so101").returncode == 0
        stop = client.until(lambda each: each.value.get("kind") == "stop", "the stop")
        assert (stop.topic, stop.value["code"]) == ("/events", "limp")
        log = client.until(
            lambda each: each.topic == "/log" and "limp confirmed" in each.value["message"], "its log"
        )
        assert log.value["name"] == "so101/stop"
        client.until(lambda each: each.topic == "/joints" and each.value["state"] == "disarmed", "it is disarmed")

        with FoxgloveClient(facts["foxglove"]) as late:
            late.until(lambda each: each.topic == "/model", "a client that comes later gets the model, too")


def panels_of(tree: dict[str, Any] | str) -> list[str]:
    """Return the names of the panels in the tree of a layout."""
    if isinstance(tree, str):
        return [tree]
    return panels_of(tree["first"]) + panels_of(tree["second"])


def test_the_layout_shows_topics_that_are_served() -> None:
    layout = json.loads(LAYOUT.read_text())
    panels = layout["configById"]
    assert sorted(panels_of(layout["layout"])) == sorted(panels)
    paths = [path["value"] for panel in panels.values() for path in panel.get("paths", ())]
    topics = {path.partition(".")[0] for path in paths} | set(panels["3D!model"]["topics"])
    topics |= {panels["RosOut!log"]["topicToRender"], panels["RawMessages!status"]["topicPath"]}
    assert topics == {JOINTS, FRAMES, SCENE, LOG, "/presence"}


@pytest.mark.long
def test_a_frozen_view_does_not_delay_the_robot(cli: Command, robot: RobotProcess) -> None:
    arguments = ("view", "so101", "--foxglove", "--port", "0", "--json", "--no-model")
    with cli.start(*arguments) as frozen, viewed(cli, "--no-model") as facts:
        try:
            assert frozen.stdout is not None and frozen.stdout.readline()
            frozen.send_signal(signal.SIGSTOP)
            with FoxgloveClient(facts["foxglove"]) as client:
                first = client.until(lambda each: each.topic == "/joints", "a reading")
                later_ns = first.log_ns + 3_000_000_000
                client.until(lambda each: each.topic == "/joints" and each.log_ns > later_ns, "telemetry goes on")
                times = [each.log_ns for each in client.messages if each.topic == "/joints"]
                assert len(times) >= 15
                assert robot.call("send_action", {"shoulder_pan": 3.0})["status"] == "success"
                assert cli.run("estop", "so101").returncode == 0
                client.until(lambda each: each.value.get("kind") == "stop", "the stop")
        finally:
            frozen.kill()


@pytest.mark.long
def test_a_robot_that_is_started_again_is_shown_again(cli: Command) -> None:
    with (
        RobotProcess(cli) as first,
        viewed(cli, "--no-model") as facts,
        FoxgloveClient(facts["foxglove"]) as client,
    ):
        client.until(lambda each: each.topic == "/joints", "a reading")
        first.process.communicate()  # its script ends
        client.until(lambda each: each.value.get("code") == "silent", "the robot is gone")
        with RobotProcess(cli):
            client.until(lambda each: each.value.get("code") == "back", "the robot is back")
            seen = len(client.messages)
            client.until(lambda each: each.topic == "/joints" and each in client.messages[seen:], "a reading")


def test_a_robot_that_does_not_run_is_refused_or_awaited(cli: Command) -> None:
    done = cli.run("view", "so101", "--foxglove", "--port", "0")
    assert (done.returncode, done.stdout) == (2, "")
    assert "robot so101 does not run. No robot runs. Start it, or wait for it with --wait" in done.stderr

    arguments = ("view", "so101", "--foxglove", "--port", "0", "--json", "--wait", "--no-model")
    with cli.start(*arguments, stderr=subprocess.PIPE) as process:
        try:
            assert process.stderr is not None and process.stdout is not None
            assert process.stderr.readline() == "waiting for so101\n"
            with RobotProcess(cli):
                facts = json.loads(process.stdout.readline())
                with FoxgloveClient(facts["foxglove"]) as client:
                    client.until(lambda each: each.topic == "/joints", "a reading")
                other = cli.run("view", "koch", "--foxglove", "--port", "0")
                assert other.returncode == 2 and "These robots run: so101" in other.stderr
            process.terminate()
            assert process.wait(20) == 0
        finally:
            process.kill()


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["view", "so101"], "give --foxglove or --rerun"),
        (["view", "so101", "--foxglove", "--save", "x.rrd"], "--save is for --rerun"),
        (["view", "a/b", "--foxglove"], "is not a robot's name"),
        (["view", "so101", "--foxglove", "--model-file", "/none.xml"], "there is no file /none.xml"),
    ],
)
def test_wrong_arguments_are_refused(arguments: list[str], text: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(arguments) == 2
    printed = capsys.readouterr()
    assert printed.out == "" and text in printed.err and printed.err.count("\n") == 1
