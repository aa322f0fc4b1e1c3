"""Repair the files of a killed recorder, and make a copy for the Hub."""

from __future__ import annotations

import contextlib
import json
import os
import random
import signal
import subprocess
import sys
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from strands_actors.surfaces.cli import dataset as commands
from strands_actors.surfaces.dataset.compact import compact
from strands_actors.surfaces.dataset.dataset import Dataset
from strands_actors.surfaces.dataset.errors import DamagedError, DatasetError
from strands_actors.surfaces.dataset.index import Index
from strands_actors.surfaces.dataset.repair import repair
from strands_actors.surfaces.dataset.run import Summary
from strands_actors.surfaces.dataset.show import show

from .made import add_episode, begin, check, fill, info_of, row

PATIENCE_S = 60.0
KILLS = int(os.environ.get("STRANDS_ACTORS_RECORDER_KILLS", "4"))


@pytest.fixture
def root(tmp_path: Path) -> Path:
    return tmp_path / "set"


def unfinished(root: Path, frames: int, episodes: int = 1) -> Path:
    """Make a dataset with counted episodes and one unfinished episode."""
    dataset = Dataset(root)
    for _ in range(episodes):
        add_episode(dataset, 10)
    episode = begin(dataset, "wave")
    fill(episode, [row(number, gap=int(number == 4)) for number in range(frames)])
    episode.abandon()
    dataset.close()
    return episode.folder


def test_an_unfinished_episode_is_repaired_and_reported(root: Path) -> None:
    unfinished(root, 50)
    report = repair(root)
    assert [one.episode for one in report.repaired] == [1] and report.total_episodes == 2
    assert check(root) == 2
    quality = Index(root).episodes[1].quality
    assert quality.repaired and quality.gaps == 1 and Index(root).episodes[1].frames >= 30
    assert not (root / ".staging").exists()


def test_an_unfinished_episode_is_dropped_on_request(root: Path) -> None:
    folder = unfinished(root, 50)
    report = repair(root, drop=True)
    assert report.dropped == [folder.name] and report.total_episodes == 1
    assert check(root) == 1 and not (root / ".staging").exists()


@pytest.mark.parametrize("seed", range(6))
def test_files_cut_off_at_any_byte_give_their_complete_frames(root: Path, seed: int) -> None:
    folder = unfinished(root, 50)
    rng = random.Random(seed)
    for name in ("frames.arrows", "front.mp4", "wrist.mp4"):
        os.truncate(
            folder / name, rng.randrange((folder / name).stat().st_size // 2, (folder / name).stat().st_size)
        )
    report = repair(root)
    assert check(root) == report.total_episodes
    assert len(report.repaired) == 1 and (report.repaired[0].problem == "") == (report.total_episodes == 2)


def test_an_episode_without_a_complete_frame_is_reported_and_stays(root: Path) -> None:
    folder = unfinished(root, 5)
    os.truncate(folder / "frames.arrows", 3)
    report = repair(root)
    assert report.repaired[0].episode == -1 and "no complete frame" in report.repaired[0].problem
    assert folder.exists() and check(root) == 1
    assert repair(root, drop=True).dropped == [folder.name] and not folder.exists()


def test_a_folder_without_a_dataset_is_not_repaired(tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match="is not a dataset"):
        repair(tmp_path)
    assert not any(tmp_path.iterdir())


def test_showing_a_dataset_reports_damage_and_changes_no_file(root: Path) -> None:
    folder = unfinished(root, 50, episodes=2)
    os.link(root / "data/chunk-000/file-000.parquet", root / "data/chunk-000/file-007.parquet")
    before = sorted(root.rglob("*"))
    shown = show(root)
    assert sorted(root.rglob("*")) == before
    assert (shown.total_episodes, shown.total_frames, shown.good) == (2, 20, [0, 1])
    assert shown.stray_files == ["data/chunk-000/file-007.parquet"]
    assert [(one.folder, one.task) for one in shown.unfinished] == [(folder.name, "wave")]
    assert shown.cameras == {"front": "96x64 av1", "wrist": "64x80 av1"}


def test_files_that_a_recorder_removes_during_a_look_are_not_reported_missing(
    root: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = unfinished(root, 50)
    gone = folder.with_name("episode-1")
    (root / "meta/stats.json.staged").symlink_to("gone")  # listed, but the file no longer exists
    (folder / "front.final.mp4").symlink_to("gone")
    monkeypatch.setattr("strands_actors.surfaces.dataset.repair.staged_folders", lambda staging: [gone, folder])
    assert [one.folder for one in show(root).unfinished] == [folder.name]


def test_a_summary_lists_the_files_put_aside_and_their_folder(
    capsys: pytest.CaptureFixture[str], root: Path
) -> None:
    dataset = Dataset(root)
    add_episode(dataset, 3)
    dataset.close()
    stranger = "data/chunk-000/file-007.parquet"
    os.link(root / "data/chunk-000/file-000.parquet", root / stranger)
    message = f"files of no episode, moved to {root}/.staging/uncounted: {stranger}"
    summary = Summary(str(root), "so101", 1.0, [], 1, [stranger], "", "done")
    assert message in commands._summed_up(summary).splitlines()
    assert commands.repair(root, drop=False, as_json=False) == 0
    assert message in capsys.readouterr().out.splitlines()
    assert (root / ".staging/uncounted" / stranger).exists()


# -- a copy in few files


def test_a_copy_has_the_same_frames_in_few_files(root: Path, tmp_path: Path) -> None:
    dataset = Dataset(root)
    for frames, task in ((33, "wave"), (7, "put the cube down"), (20, "wave")):
        add_episode(dataset, frames, task)
    dataset.close()
    copy = tmp_path / "copy"
    done = compact(root, copy)
    assert (done.episodes, done.frames, done.files, done.files_before) == (3, 60, 7, 15)
    assert check(copy) == 3 and check(root) == 3
    assert copy.stat().st_mode & 0o777 == 0o700
    rows = pq.read_table(copy / "meta/episodes/chunk-000/file-000.parquet").to_pylist()
    assert [each["videos/observation.images.front/from_timestamp"] for each in rows] == [0.0, 33 / 30, 40 / 30]
    assert info_of(copy) == info_of(root) and show(copy).good == [0, 1, 2]
    again = Dataset(copy)  # the copy accepts new episodes
    add_episode(again, 5)
    again.close()
    assert check(copy) == 4


def test_a_file_is_not_larger_than_lerobot_makes_it(
    root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    dataset = Dataset(root)
    for _ in range(3):
        add_episode(dataset, 12)
    dataset.close()
    size = (root / "videos/observation.images.front/chunk-000/file-000.mp4").stat().st_size
    monkeypatch.setattr("strands_actors.surfaces.dataset.copied_files.VIDEO_MB", 2.5 * size / 1e6)
    compact(root, tmp_path / "copy")
    assert len(list((tmp_path / "copy/videos/observation.images.front").glob("*/*.mp4"))) == 2
    assert check(tmp_path / "copy") == 3


def test_a_copy_replaces_nothing(root: Path, tmp_path: Path) -> None:
    dataset = Dataset(root)
    add_episode(dataset, 3)
    with pytest.raises(DatasetError, match="exists already"):
        compact(root, root)
    with pytest.raises(DatasetError, match="is not a dataset"):
        compact(tmp_path / "none", tmp_path / "copy")
    theirs = tmp_path / "copy.staged/notes.txt"
    theirs.parent.mkdir()
    theirs.write_text("mine")
    with pytest.raises(DatasetError, match="another copy is being made, or a copy was interrupted"):
        compact(root, tmp_path / "copy")
    assert theirs.read_text() == "mine" and not (tmp_path / "copy").exists()


def test_a_copy_beside_a_recorder_has_the_figures_of_its_own_episodes(
    root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    dataset = Dataset(root)
    add_episode(dataset, 33)

    def and_one_more(root: Path) -> Index:
        index = Index(root)
        add_episode(dataset, 7, "wave")
        return index

    monkeypatch.setattr("strands_actors.surfaces.dataset.compact.Index", and_one_more)
    copy = tmp_path / "copy"
    compact(root, copy)
    assert check(copy) == 1 and check(root) == 2
    assert json.loads((copy / "meta/stats.json").read_bytes())["action"]["count"] == [33]
    assert pq.read_table(copy / "meta/tasks.parquet").num_rows == info_of(copy)["total_tasks"] == 1


def test_a_copy_that_cannot_be_made_leaves_nothing(root: Path, tmp_path: Path) -> None:
    dataset = Dataset(root)
    for _ in range(2):
        add_episode(dataset, 3)
    (root / "videos/observation.images.front/chunk-000/file-001.mp4").unlink()
    before = sorted(tmp_path.rglob("*"))
    with pytest.raises(DamagedError, match=r"episode 1 is damaged: .*file-001.mp4 is missing"):
        compact(root, tmp_path / "copy")
    assert sorted(tmp_path.rglob("*")) == before


def test_a_copy_can_be_copied(root: Path, tmp_path: Path) -> None:
    """Several episodes share a file in it, as in LeRobot's own datasets."""
    dataset = Dataset(root)
    for frames in (33, 7, 20):
        add_episode(dataset, frames)
    compact(root, tmp_path / "copy")
    again = compact(tmp_path / "copy", tmp_path / "again")
    assert (again.episodes, again.frames) == (3, 60) and check(tmp_path / "again") == 3


# -- SIGKILL


def killed(root: Path, after_lines: int, delay_s: float) -> int:
    """Kill a process that writes episodes. Return how many it had reported as finished."""
    process = subprocess.Popen(
        [sys.executable, "-m", "tests.dataset.writing", str(root)], stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    finished = 0
    try:
        for _ in range(after_lines):
            finished += process.stdout.readline() == "finished\n"
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(delay_s)
    finally:
        process.send_signal(signal.SIGKILL)
    return finished + process.communicate(timeout=PATIENCE_S)[0].count("finished\n")


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize("seed", range(KILLS))
def test_a_writer_that_is_killed_loses_no_finished_episode(root: Path, seed: int) -> None:
    rng = random.Random(seed)
    finished = killed(root, 1 + seed % 4, rng.uniform(0.0, 0.4))
    assert after_a_kill(root) >= finished


def after_a_kill(root: Path) -> int:
    """Check the files after a kill, before and after a writer opens them. Return the number of episodes."""
    if (root / "meta/info.json").exists():
        swept_by_hand = Index(root).stray_files()
        if not swept_by_hand:
            check(root)
    Dataset(root).close()
    counted = len(Index(root).episodes)
    repair(root)
    assert check(root) >= counted
    dataset = Dataset(root)
    add_episode(dataset, 3)
    dataset.close()
    return check(root) - 1
