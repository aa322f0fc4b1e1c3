"""A recorder that streams to a second place is killed at any moment, or the place fails. Each finished
episode is there once, and the recording goes on."""

from __future__ import annotations

import contextlib
import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from strands_actors import record_dataset
from strands_actors.surfaces.dataset import DatasetError
from strands_actors.surfaces.dataset.dataset import Dataset
from strands_actors.surfaces.dataset.index import Index
from strands_actors.surfaces.dataset.second.bring import copy_all
from strands_actors.surfaces.dataset.second.opening import open_place
from strands_actors.surfaces.dataset.second.place import PlaceError
from strands_actors.surfaces.dataset.show import show

from .buckets import bucket
from .quick import files_of, grown
from .test_second import contents

PATIENCE_S = 60.0


@contextlib.contextmanager
def streaming(root: Path, url: str) -> Iterator[tuple[subprocess.Popen[str], int]]:
    """Yield a running recorder, and the number of the process that copies."""
    with subprocess.Popen(
        [sys.executable, "-m", "tests.dataset.streaming", str(root), url], stdout=subprocess.PIPE, text=True
    ) as recorder:
        try:
            yield recorder, int(heard(recorder, "process ").split()[1])
        finally:
            recorder.kill()


def finished_until_killed(root: Path, url: str, rng: random.Random) -> int:
    """Kill the recorder, or first the process that copies, at a random moment. Return how many episodes it had
    finished."""
    with streaming(root, url) as (recorder, copier):
        assert recorder.stdout is not None
        finished = 0
        for line in recorder.stdout:
            finished += line == "finished\n"
            if finished > rng.randrange(4):
                break
        time.sleep(rng.random() * 0.2)
        if rng.random() < 0.5:
            with contextlib.suppress(ProcessLookupError):
                os.kill(copier, signal.SIGKILL)
            time.sleep(rng.random() * 0.1)
        recorder.kill()
        finished += sum(line == "finished\n" for line in recorder.stdout)
        return finished


def resumed(root: Path, url: str) -> None:
    """Copy the missing episodes, as soon as the process of a killed recorder has ended."""
    until = time.monotonic() + PATIENCE_S
    while True:
        try:
            place = open_place(url, root)
            try:
                copy_all(root, place, False, lambda there, of: None)
                return
            finally:
                place.close()
        except PlaceError:
            assert time.monotonic() < until
            time.sleep(0.05)


def kill_often(root: Path, url: str, kills: int, seed: int) -> int:
    """Kill and resume. Return the number of episodes, each of which is in both places once."""
    rng = random.Random(seed)
    finished = 0
    for _ in range(kills):
        finished += finished_until_killed(root, url, rng)
        Dataset(root).close()  # The next recorder does this: it commits finished episodes.
        episodes = len(Index(root).episodes)
        assert episodes == finished
        resumed(root, url)
        place = open_place(url, root)
        there = contents(place)
        place.close()
        assert there == files_of(root)
    return finished


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize(("kills", "seed"), [(2, 0), *((5, seed) for seed in range(1, 21))])
def test_no_kill_loses_or_doubles_an_episode_in_a_folder(tmp_path: Path, kills: int, seed: int) -> None:
    second = tmp_path / "second"
    finished = kill_often(tmp_path / "set", str(second), kills, seed)
    assert show(second).good == list(range(finished)) and show(second).stray_files == []


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize(("kills", "seed"), [(1, 0), *((5, seed) for seed in range(1, 5))])
def test_no_kill_loses_or_doubles_an_episode_in_a_bucket(tmp_path: Path, kills: int, seed: int) -> None:
    with bucket("pick") as url:
        assert kill_often(tmp_path / "set", f"{url}/set", kills, seed) > 0


def heard(recorder: subprocess.Popen[str], text: str) -> str:
    assert recorder.stdout is not None
    for line in recorder.stdout:
        if text in line:
            return line
    raise AssertionError(f"it ended before it said {text}")


def until(is_true: Callable[[], bool]) -> None:
    end = time.monotonic() + PATIENCE_S
    while not is_true():
        assert time.monotonic() < end
        time.sleep(0.02)


def test_a_place_that_goes_away_is_named_and_what_it_missed_is_copied_when_it_returns(tmp_path: Path) -> None:
    root, second = tmp_path / "set", tmp_path / "disk" / "second"
    second.parent.mkdir()
    with streaming(root, str(second)) as (recorder, _):
        heard(recorder, "copied to")
        second.parent.rename(tmp_path / "unplugged")
        assert "Recording continues" in heard(recorder, "not copied:")
        for _ in range(3):
            heard(recorder, "finished")
        assert not second.parent.exists(), "nothing was written beside the disk"
        (tmp_path / "unplugged").rename(second.parent)
        before = len(Index(second).episodes)
        heard(recorder, "copied to")
        until(lambda: len(Index(second).episodes) > before + 2)


@pytest.mark.long
def test_a_killed_copying_process_is_started_again(tmp_path: Path) -> None:
    with streaming(tmp_path / "set", str(tmp_path / "second")) as (recorder, copier):
        heard(recorder, "copied to")
        os.kill(copier, signal.SIGKILL)
        heard(recorder, "It is started again")
        heard(recorder, "copied to")


@pytest.mark.long
def test_a_frozen_copying_process_does_not_stop_the_recording(tmp_path: Path) -> None:
    with streaming(tmp_path / "set", str(tmp_path / "second")) as (recorder, copier):
        heard(recorder, "copied to")
        os.kill(copier, signal.SIGSTOP)
        for _ in range(5):
            heard(recorder, "finished")
        os.kill(copier, signal.SIGKILL)


def test_another_dataset_is_refused_before_anything_is_recorded(tmp_path: Path) -> None:
    second = grown(tmp_path / "second", 2)
    recorder = subprocess.run(
        [sys.executable, "-m", "tests.dataset.streaming", str(tmp_path / "set"), str(second)],
        capture_output=True, text=True, timeout=PATIENCE_S, check=False,
    )  # fmt: skip
    assert "has a dataset already, and" in recorder.stderr and "finished" not in recorder.stdout
    assert show(second).good == [0, 1]


def test_a_script_streams_what_it_records_and_is_told_what_is_not_copied(arm: Any, tmp_path: Path) -> None:
    root, second = tmp_path / "set", tmp_path / "second"
    with record_dataset(arm, root, task="wave", copy_to=second) as recording:
        for _ in range(2):
            with recording.episode():
                time.sleep(0.2)
    assert recording.not_copied == "" and show(second).good == [0, 1]
    second.rename(tmp_path / "kept")
    second.write_text("a file is in its place")
    with record_dataset(arm, root, task="wave", copy_to=second) as recording, recording.episode():
        time.sleep(0.2)
    assert [one["episode"] for one in recording.saved] == [2]
    assert "3 of 3 episodes are not in the second place yet" in recording.not_copied
    assert "Not a directory" in recording.not_copied or "File exists" in recording.not_copied
    with pytest.raises(DatasetError, match="is the dataset's own folder"):
        record_dataset(arm, root, task="wave", copy_to=root / "copy")
