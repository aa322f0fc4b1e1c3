"""A script and its recorder: another program also commands the recorder, or the recorder freezes or dies."""

from __future__ import annotations

import signal
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from strands_actors import Robot, Teleoperator, record_dataset
from strands_actors.surfaces.dataset import DatasetError, DatasetRecording
from strands_actors.surfaces.dataset.index import Index
from strands_actors.surfaces.dataset.repair import repair
from tests.answers import json_of, until
from tests.teleop.test_page import operator

from .made import check
from .test_page_keys import say, shown
from .test_so101 import PATIENCE_S, wave


@pytest.fixture
def arm() -> Iterator[Any]:
    with Robot("so101", mode="real", transport="twin") as arm:
        yield arm


def test_an_answer_to_a_page_does_not_answer_a_script(arm: Any, tmp_path: Path) -> None:
    root = tmp_path / "set"
    with Teleoperator("page") as page:
        json_of(arm.attach_teleop(page))
        address = until(lambda: page.address, "it is served")
        with record_dataset(arm, root, task="wave") as recording, operator(address) as socket:
            say(socket, "finish")
            shown(socket, lambda told: "no episode is running" in told["last_event"])
            recording.start()  # this must not count as a refusal of the earlier finish
            with pytest.raises(DatasetError, match="start: an episode is running"):
                recording.start()
            shown(socket, has_frames)
            say(socket, "finish")
            shown(socket, lambda told: told["last_event"].endswith("saved"))
            with pytest.raises(DatasetError, match="finish: no episode is running"):
                recording.finish()
            with recording.episode():
                shown(socket, has_frames)
            assert [one["episode"] for one in recording.saved] == [1], "its own"
        json_of(arm.stop_task())
    assert check(root) == len(Index(root).episodes) == 2


def has_frames(status: dict[str, Any]) -> bool:
    return "fps" in status["text"] and ", 0 fps" not in status["text"]


def killed(recording: DatasetRecording, how: signal.Signals) -> None:
    assert recording._process is not None
    recording._process.send_signal(how)


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize("word", ["start", "finish", "discard"])
def test_a_frozen_recorder_is_dropped_and_its_episode_is_repaired(
    arm: Any, tmp_path: Path, word: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    root = tmp_path / "set"
    with pytest.raises(ZeroDivisionError), record_dataset(arm, root, task="wave") as recording:
        if word != "start":
            recording.start()
            wave(
                arm,
                PATIENCE_S,
                lambda: any(path.stat().st_size > 8000 for path in root.glob(".staging/*/*.arrows")),
            )
        killed(recording, signal.SIGSTOP)
        monkeypatch.setattr("strands_actors.surfaces.dataset.script.SILENT_S", 2.0)
        began_s = time.monotonic()
        for _ in range(2):
            with pytest.raises(DatasetError, match=f"the recorder did not answer.*dataset repair {root}"):
                getattr(recording, word)()
        assert time.monotonic() - began_s < 10.0
        raise ZeroDivisionError
    assert repair(root).total_episodes == (word != "start") if (root / ".staging").exists() else word == "start"


def test_the_exception_of_a_block_survives_the_death_of_its_recorder(arm: Any, tmp_path: Path) -> None:
    with (
        pytest.raises(ZeroDivisionError),
        record_dataset(arm, tmp_path / "set", task="wave") as recording,
        recording.episode(),
    ):
        killed(recording, signal.SIGKILL)
        raise ZeroDivisionError


def test_a_killed_recorder_is_reported_with_a_remedy(arm: Any, tmp_path: Path) -> None:
    root = tmp_path / "set"
    with (
        pytest.raises(
            DatasetError,
            match=f"ended with code -9. Save the recorded frames with `strands-actors dataset repair {root}`",
        ),
        record_dataset(arm, root, task="wave") as recording,
        recording.episode(),
    ):
        killed(recording, signal.SIGKILL)


def test_a_script_gets_an_error_when_its_robot_is_gone(arm: Any, tmp_path: Path) -> None:
    root = tmp_path / "set"
    with (
        pytest.raises(DatasetError, match=f"so101: the robot is gone.*not finished.*dataset repair {root}"),
        record_dataset(arm, root, task="wave") as recording,
        recording.episode(),
    ):
        wave(arm, 0.5)
        arm.cleanup()
        assert recording._process is not None
        recording._process.wait(PATIENCE_S)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        *(
            ({"robot": robot}, "robot is .* Give a connected robot")
            for robot in (5, None, ["so101"], "", b"so101", Robot)
        ),
        ({"robot": Path("so101")}, "robot is .* Give a connected robot"),
        *(({"root": root}, "root is .* Give a path") for root in (5, None, "", b"set", ["set"])),
        *(
            ({"cameras": cameras}, "cameras is .* in a list")
            for cameras in (5, None, [["w"]], [5], b"w", "", [None])
        ),
        *(({"codec": codec}, "there is no codec .* Use av1 or mpeg4") for codec in (["av1"], 5, "", True)),
        *(({"task": task}, "task is missing") for task in (5, None, "", ["wave"])),
        *(({"fps": fps}, "fps is .* Give a whole number from 1 to 240") for fps in (30.0, "30", None, True, 0)),
    ],
)
def test_a_slip_is_refused_by_name_and_nothing_is_written(
    given: dict[str, Any], message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    arguments: dict[str, Any] = {"robot": "so101", "root": "set", "task": "wave"}
    with pytest.raises(DatasetError, match=message):
        record_dataset(**arguments | given)
    assert not any(tmp_path.iterdir())
