"""A separate process records an SO-101 twin into a dataset. A slow or dead recorder does not disturb the arm."""

from __future__ import annotations

import json
import math
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import msgspec
import pyarrow.parquet as pq
import pytest

from strands_actors import Robot, record_dataset, register_native_driver, register_robot
from strands_actors.surfaces import cli
from strands_actors.surfaces.cli.dataset import is_achieved
from strands_actors.surfaces.dataset import DatasetError
from strands_actors.surfaces.dataset.dataset import Dataset
from strands_actors.surfaces.dataset.index import Index
from strands_actors.surfaces.dataset.order import Order
from strands_actors.surfaces.dataset.repair import repair
from strands_actors.surfaces.dataset.run import EpisodeSummary, Summary
from strands_actors.surfaces.dataset.show import show
from strands_actors.surfaces.recording.recorder import GONE
from strands_actors.testing import Twin
from tests.cli.command import Command, refusal_code
from tests.cli.terminal import Terminal

from .foreign import create
from .made import add_episode, check, decoded, info_of
from .pan import Pan

PATIENCE_S = 90.0
AXES = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper")


def wave(arm: Any, seconds: float, until: Callable[[], bool] = lambda: False) -> int:
    """Move, and return how many setpoints were accepted. On a busy machine some are late before they are sent."""
    began, count = time.monotonic(), 0
    while not until() and (since := time.monotonic() - began) < seconds:
        answer = arm.send_action({"shoulder_pan": 10 * math.sin(since), "gripper": 30 + 10 * math.cos(since)})
        assert answer["status"] == "success" or refusal_code(answer) == "expired", answer
        count += answer["status"] == "success"
        time.sleep(0.02)
    return count


@contextmanager
def stand_in(root: Path, slow_s: float = 0.0) -> Iterator[subprocess.Popen[str]]:
    """Yield a running recorder with its own camera."""
    order = Order("so101", str(root), "wave", 30, ("front",))
    with subprocess.Popen(
        [sys.executable, "-m", "tests.dataset.stand_in", msgspec.json.encode(order).decode(), str(slow_s)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as process:
        try:
            assert heard(process, "ready")
            yield process
        finally:
            process.kill()


def say(process: subprocess.Popen[str], word: str) -> None:
    assert process.stdin is not None
    process.stdin.write(word + "\n")
    process.stdin.flush()


def heard(process: subprocess.Popen[str], what: str) -> dict[str, Any]:
    assert process.stdout is not None
    for line in process.stdout:
        event: dict[str, Any] = json.loads(line)
        if event.get("what") == what:
            return event
    raise AssertionError(f"it ended before it said {what}")


def rows_of(root: Path, episode: int = 0) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = pq.read_table(root / f"data/chunk-000/file-{episode:03d}.parquet").to_pylist()
    return found


def test_a_script_records_episodes_with_requested_and_executed_actions(arm: Any, tmp_path: Path) -> None:
    root = tmp_path / "set"
    with record_dataset(arm, root, task="wave") as recording:
        with recording.episode():
            wave(arm, 1.5)
            assert arm.send_action({"shoulder_pan": 400.0})["status"] == "error"
            time.sleep(0.2)
        with pytest.raises(ZeroDivisionError), recording.episode():
            wave(arm, 0.1)
            raise ZeroDivisionError
        with pytest.raises(DatasetError, match="no episode is running"):
            recording.finish()
        with recording.episode():
            wave(arm, 0.5)
        assert [one["episode"] for one in recording.saved] == [0, 1]
    assert check(root) == 2 and info_of(root)["robot_type"] == "strands_so101"
    assert info_of(root)["features"]["action"]["names"] == [f"{axis}.pos" for axis in AXES]
    assert info_of(root)["features"]["action"]["units"] == ["deg"] * 5 + ["percent"]
    rows = rows_of(root)
    assert len({tuple(row["action"]) for row in rows}) > 5
    last = rows[-1]
    assert last["requested_action"][0] == 400.0 and abs(last["action"][0]) <= 10.0
    assert all(0.0 <= row["age_ms"] < 5000 for row in rows)
    assert all(abs(row["observation.state"][0]) <= 15 for row in rows)


@pytest.mark.long
def test_an_axis_that_nothing_reads_is_named_and_nothing_is_recorded(tmp_path: Path) -> None:
    register_robot("pan")
    register_native_driver("pan", Pan)
    with Robot("pan", mode="real", port="/dev/x") as arm:
        arm.get_observation()
        with pytest.raises(DatasetError, match="no readings of gripper of pan"):
            record_dataset(arm, tmp_path / "set", task="wave").__enter__()


def test_a_script_gets_an_error_when_its_folder_is_moved_away(arm: Any, tmp_path: Path) -> None:
    root = tmp_path / "set"
    with (
        pytest.raises(DatasetError, match="was moved, or its disk was unmounted"),
        record_dataset(arm, root, task="wave") as recording,
    ):
        with recording.episode():
            wave(arm, 0.5)
        root.rename(tmp_path / "moved")
        root.mkdir()
        with recording.episode():
            wave(arm, 0.5)
    assert len(recording.saved) == 1 == check(tmp_path / "moved")
    assert not (root / "meta").exists()


@pytest.mark.long
def test_saf_001_a_slow_disk_costs_frames_which_are_counted_and_no_setpoint(
    arm: Any, twin: Twin, tmp_path: Path
) -> None:
    root = tmp_path / "set"
    with stand_in(root, slow_s=1.5) as recorder:
        say(recorder, "start")
        heard(recorder, "started")
        began_ns = time.monotonic_ns()
        sent = wave(arm, 5.0)
        ended_ns = time.monotonic_ns()
        say(recorder, "finish")
        saved = heard(recorder, "saved")
        recorder.send_signal(signal.SIGINT)
        recorder.wait(PATIENCE_S)
    written = [entry for entry in twin.log.host("setpoint", began_ns) if entry.t_ns <= ended_ns]
    assert len(written) >= sent > 20, "each left"
    assert not [entry for entry in twin.log.host("safe", began_ns) if entry.t_ns <= ended_ns], "nothing was late"
    (episode,) = Index(root).episodes
    assert episode.quality.gaps > 0 and saved["frames"] == episode.frames >= 30
    assert f"{episode.quality.gaps} frames missing" in saved["marks"]
    assert show(root).good == []


def test_saf_003_a_recorder_that_freezes_and_dies_costs_the_arm_nothing_and_its_episode_is_repaired(
    arm: Any, twin: Twin, tmp_path: Path
) -> None:
    root = tmp_path / "set"
    with stand_in(root) as recorder:
        say(recorder, "start")
        heard(recorder, "started")
        wave(arm, PATIENCE_S, lambda: any(path.stat().st_size > 8000 for path in root.glob(".staging/*/*.arrows")))
        began_ns = time.monotonic_ns()
        recorder.send_signal(signal.SIGSTOP)
        wave(arm, 0.5)
        recorder.kill()
        recorder.wait(PATIENCE_S)
        wave(arm, 0.5)
        ended_ns = time.monotonic_ns()
    assert not [entry for entry in twin.log.host("safe", began_ns) if entry.t_ns <= ended_ns]
    assert not (root / "meta/info.json").exists(), "no episode is counted yet"
    report = repair(root)
    assert [one.episode for one in report.repaired] == [0] and report.repaired[0].frames >= 15
    pictures = decoded(root / "videos/observation.images.front/chunk-000/file-000.mp4")
    assert [at_s for at_s, _ in pictures] == [number / 30 for number in range(len(rows_of(root)))]
    assert len({picture.tobytes() for _, picture in pictures}) > len(pictures) / 4, "the scene changes"
    assert info_of(root)["features"]["age_ms"]["names"] == ["state", "front"]
    assert Index(root).episodes[0].quality.repaired


@pytest.mark.long
def test_the_command_records_by_keys(arm: Any, tmp_path: Path) -> None:
    root = tmp_path / "set"
    command = Command(Path(os.environ["STRANDS_ACTORS_RUN"]))
    with Terminal(
        command, "record", "so101", "--dataset", str(root), "--task", "wave", "--episodes", "2"
    ) as terminal:

        def shown(text: bytes, times: int = 1) -> None:
            wave(arm, PATIENCE_S, lambda: terminal.shown.count(text) >= times)
            assert terminal.shown.count(text) >= times, terminal.shown.decode()

        shown(b"30 fps, no cameras")
        shown(b"space: start, finish")
        terminal.press(b"x d ")  # not a key, nothing to discard, start: all are handled in order
        shown(b"episode 0: recording")
        terminal.press(b"a")
        shown(b"episode 0: discarded")
        shown(b"episode 0: recording", 2)
        wave(arm, 0.5)
        terminal.press(b" ")
        shown(b"; saved")
        terminal.press(b" ")
        shown(b"episode 1: recording")
        shown(b" gaps, ")
        terminal.press(b"q")
        assert terminal.process.wait(PATIENCE_S) == 0
        assert terminal.settings() == terminal.settings_before
    assert b"1/2 saved" in terminal.shown and b"GB left" in terminal.shown
    assert check(root) == 2


def test_the_command_records_without_keys_and_reports_in_json(
    arm: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("strands_actors.surfaces.cli.dataset.give_way", lambda: None)  # keeps the priority

    def run(*arguments: str) -> Any:
        code = cli.run([*arguments, "--json"])
        output = capsys.readouterr()
        assert code == 0, output.err
        return json.loads(output.out)

    root = tmp_path / "set"
    create(root, [f"{axis}.pos" for axis in AXES], {})  # as LeRobot creates it, before the first recording
    said = run("record", "so101", "--dataset", str(root), "--task", "w", "--episodes", "2", "--seconds", "0.5")
    assert said["total_episodes"] == 2 and len(said["episodes"]) == 2 and said["left"] == ""
    assert check(root) == 2
    assert run("dataset", "show", str(root))["total_frames"] == sum(one["frames"] for one in said["episodes"])
    assert run("dataset", "repair", str(root))["repaired"] == []
    copy = tmp_path / "copy"
    assert run("dataset", "compact", str(root), "-o", str(copy))["episodes"] == 2 and check(copy) == 2


@pytest.mark.parametrize(
    ("episodes", "saved", "ended", "left", "achieved"),
    [
        (5, 2, GONE, "", False),
        (2, 2, GONE, "", True),
        (None, 2, GONE, "", True),
        (None, 2, GONE, "repair it", False),
        (5, 2, "interrupted", "repair it", True),
        (5, 2, "done", "", True),
    ],
)
def test_a_robot_that_ends_before_the_last_episode_is_not_a_success(
    episodes: int | None, saved: int, ended: str, left: str, achieved: bool
) -> None:
    summaries = [EpisodeSummary(number, 30, 1.0, 0, "") for number in range(saved)]
    summary = Summary("set", "so101", 9.0, summaries, saved, [], left, ended)
    assert is_achieved(Order("so101", "set", "w", episodes=episodes), summary) is achieved


@pytest.mark.long
def test_the_exit_code_shows_that_the_robot_is_gone(arm: Any, tmp_path: Path) -> None:
    command = Command(Path(os.environ["STRANDS_ACTORS_RUN"]))
    arguments = ("--task", "w", "--episodes", "5", "--seconds", "30")
    with command.start("record", "so101", "--dataset", str(tmp_path / "set"), *arguments) as recorder:
        try:
            assert recorder.stderr is not None
            assert next(line for line in recorder.stderr if "episode 0: recording" in line)
            arm.cleanup()
            assert recorder.wait(PATIENCE_S) == 1
        finally:
            recorder.kill()


def test_a_page_that_cannot_be_served_is_refused_in_one_line(arm: Any, tmp_path: Path) -> None:
    command = Command(Path(os.environ["STRANDS_ACTORS_RUN"]))
    done = command.run(
        "record", "so101", "--dataset", str(tmp_path / "set"), "--task", "w", "--keys", "phone:203.0.113.9:8000"
    )
    assert done.returncode == cli.USAGE, done.stderr
    assert done.stderr.splitlines()[-1].startswith("strands-actors: record: no page at 203.0.113.9:8000")
    assert "Traceback" not in done.stderr
    assert not (tmp_path / "set").exists()


def test_a_codec_other_than_the_datasets_is_refused_before_recording(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("strands_actors.surfaces.cli.dataset.give_way", lambda: None)
    dataset = Dataset(tmp_path)
    add_episode(dataset, 3)
    dataset.close()
    arguments = ("record", "so101", "--dataset", str(tmp_path), "--task", "w", "--codec", "mpeg4")
    assert cli.run(arguments) == cli.USAGE
    assert "has videos with the codec av1, not mpeg4" in capsys.readouterr().err
    assert check(tmp_path) == 1


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("record", "so101"), "give -o FILE, or --dataset DIR"),
        (("record", "so101", "--dataset", "set"), "task is missing"),
        (("record", "so101", "--dataset", "set", "--task", "x", "--codec", "h264"), "Use av1 or mpeg4"),
        (("record", "nobody", "--dataset", "set", "--task", "x"), "no robot 'nobody'"),
        (("dataset", "show", "set"), "is not a dataset"),
        (("dataset", "repair", "set"), "is not a dataset"),
    ],
)
def test_invalid_arguments_are_refused_in_one_line(
    arguments: tuple[str, ...], message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("strands_actors.surfaces.cli.dataset.give_way", lambda: None)
    assert cli.run(arguments) == cli.USAGE
    output = capsys.readouterr().err
    assert message in output and output.count("\n") == 1
    assert not any(tmp_path.iterdir())
