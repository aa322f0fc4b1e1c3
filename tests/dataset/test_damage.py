"""Damage each file in every way. No traceback, no wrong count and no lost good episode may follow.

The oracle is the original data. It reads the original files by itself and does not use the code under
test.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import random
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import av
import msgspec
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from strands_actors.surfaces.cli import dataset as commands
from strands_actors.surfaces.cli import dataset_copies
from strands_actors.surfaces.cli.errors import Problem
from strands_actors.surfaces.dataset.compact import compact, convert
from strands_actors.surfaces.dataset.dataset import Dataset
from strands_actors.surfaces.dataset.errors import DamagedError, DatasetError
from strands_actors.surfaces.dataset.repair import repair
from strands_actors.surfaces.dataset.show import Shown, show

from .foreign import KEY, LENGTHS, write_older
from .made import LAYOUT, begin, fill, row, scene

FRAMES = (6, 9, 6, 11, 4)
CAMERAS = ("front", "wrist")
SEEDS = 200
DATA = "data/chunk-000/file-{:03d}.parquet"
INDEX = "meta/episodes/chunk-000/file-{:03d}.parquet"
VIDEO = "videos/observation.images.{}/chunk-000/file-{:03d}.mp4"


class Original(msgspec.Struct, frozen=True):
    """An undamaged dataset and the contents of each of its files."""

    root: Path
    frames: tuple[int, ...]
    data: tuple[str, ...]  # of each episode
    videos: tuple[tuple[str, ...], ...]
    index: tuple[str, ...]
    has_checksums: bool
    contents: tuple[str, ...]  # of each episode, as ``contents_of`` reads them

    def affected_by(self, name: str) -> set[int]:
        return {
            number
            for number in range(len(self.frames))
            if name in (self.data[number], self.index[number], *self.videos[number])
        }


def contents_of(root: Path, frames: tuple[int, ...], number: int, data: str, videos: tuple[str, ...]) -> str:
    """Return the contents of an episode, read from its original files. Raise an exception if it is missing."""
    rows = [each for each in rows_in(root / data) if each["episode_index"] == number]
    assert [each["frame_index"] for each in rows] == list(range(frames[number]))
    digest = hashlib.sha256(repr(rows).encode())
    for video in videos:
        pictures = pictures_in(root / video)
        first = sum(frames[:number]) if video.endswith("file-000.mp4") and max(pictures) >= max(frames) else 0
        for at in range(first, first + frames[number]):
            digest.update(pictures[at])
    return digest.hexdigest()


def rows_in(path: Path) -> list[dict[str, Any]]:
    """Return the rows of all row groups that can be read."""
    found: list[dict[str, Any]] = []
    with pq.ParquetFile(path) as file:
        for group in range(file.num_row_groups):
            with contextlib.suppress(pa.ArrowException, OSError):
                found += file.read_row_group(group).to_pylist()
    return found


def pictures_in(path: Path) -> dict[int, bytes]:
    """Return each picture that can be decoded, by number, including those after a damaged one."""
    found: dict[int, bytes] = {}
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        stream.codec_context.thread_count = 1  # else pictures wait in the decoder when it fails
        assert stream.time_base is not None
        for packet in container.demux(stream):
            with contextlib.suppress(av.error.FFmpegError):
                for frame in stream.decode(packet):
                    found[round((frame.pts or 0) * stream.time_base * 30)] = frame.to_ndarray().tobytes()
    return found


def original(
    root: Path,
    frames: tuple[int, ...],
    data: list[str],
    videos: list[tuple[str, ...]],
    index: list[str],
    has_checksums: bool = True,
) -> Original:
    contents = tuple(contents_of(root, frames, n, data[n], videos[n]) for n in range(len(frames)))
    return Original(root, frames, tuple(data), tuple(videos), tuple(index), has_checksums, contents)


@pytest.fixture(scope="module")
def originals(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Original]:
    """Return the dataset in three forms: as recorded with a file for each episode, as a copy in few files, and
    in version 2.1."""
    folder = tmp_path_factory.mktemp("originals")
    dataset = Dataset(folder / "recorded")
    for number, frames in enumerate(FRAMES):
        episode = begin(dataset, "wave" if number % 2 else "put the cube down")
        for frame in range(100 * number, 100 * number + frames):
            episode.add(row(frame), {camera.name: scene(camera, frame) for camera in LAYOUT.cameras})
        episode.finish()
        dataset.commit(episode.folder)
    dataset.close()
    compact(folder / "recorded", folder / "copied")
    write_older(folder / "older")
    count = range(len(FRAMES))
    older = range(len(LENGTHS))
    one = DATA.format(0), tuple(VIDEO.format(camera, 0) for camera in CAMERAS), INDEX.format(0)
    return {
        "recorded": original(
            folder / "recorded",
            FRAMES,
            [DATA.format(n) for n in count],
            [tuple(VIDEO.format(camera, n) for camera in CAMERAS) for n in count],
            [INDEX.format(n) for n in count],
        ),
        "copied": original(folder / "copied", FRAMES, [one[0]] * 5, [one[1]] * 5, [one[2]] * 5),
        "older": original(
            folder / "older",
            LENGTHS,
            [f"data/chunk-000/episode_{n:06d}.parquet" for n in older],
            [(f"videos/chunk-000/{KEY}/episode_{n:06d}.mp4",) for n in older],
            ["meta/episodes.jsonl"] * 3,
            has_checksums=False,
        ),
    }


@pytest.fixture
def recorded(originals: dict[str, Original], tmp_path: Path) -> Path:
    root = tmp_path / "set"
    shutil.copytree(originals["recorded"].root, root)
    return root


# -- kinds of damage that users have had


def replace_data(root: Path) -> None:
    shutil.copy(root / DATA.format(0), root / DATA.format(2))


def cut_video(root: Path) -> None:
    path = root / VIDEO.format("front", 3)
    os.truncate(path, path.stat().st_size * 2 // 3)


def swap_videos(root: Path) -> None:
    """The videos have the same camera and length. Only their checksums differ."""
    exchange(root / VIDEO.format("front", 0), root / VIDEO.format("front", 2))


def point_at_the_file_before(root: Path) -> None:
    """LeRobot 0.4.0's converter wrote it this way."""
    path = root / INDEX.format(3)
    table = pq.read_table(path)
    at = table.schema.get_field_index("data/file_index")
    pq.write_table(table.set_column(at, table.schema.field(at), [[2]]), path)


def cut_parquet(root: Path) -> None:
    os.truncate(root / DATA.format(1), 700)


def remove_video(root: Path) -> None:
    (root / VIDEO.format("wrist", 4)).unlink()


def cut_index(root: Path) -> None:
    os.truncate(root / INDEX.format(1), 200)


def zero_inside_a_video(root: Path) -> None:
    path = root / VIDEO.format("wrist", 1)
    with path.open("r+b") as file:
        file.seek(-40, os.SEEK_END)
        file.write(bytes(20))


@pytest.mark.parametrize(
    ("damage", "numbers", "frames", "why"),
    [
        (replace_data, [2], range(30, 31), "has 0 frames of the episode, but the index lists 6"),
        (cut_video, [3], range(26, 36), "pictures of the episode, but the index lists 11"),
        (swap_videos, [0, 2], range(36, 37), "have changed since they were recorded"),
        (point_at_the_file_before, [3], range(25, 26), r"its frames are in data/chunk-000/file-003.parquet"),
        (cut_parquet, [1], range(27, 28), "cannot be read"),
        (remove_video, [4], range(32, 33), "is missing"),
        (cut_index, [1], range(27, 28), "the index has no row of it"),
        (zero_inside_a_video, [1], range(36, 37), "have changed since they were recorded"),
    ],
)
def test_damage_is_named_and_not_called_repaired_and_no_copy_loses_a_frame(
    damage: Callable[[Path], None],
    numbers: list[int],
    frames: range,
    why: str,
    recorded: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    damage(recorded)
    before = hashes(recorded)
    shown = show(recorded)
    assert shown.damaged == numbers and shown.good == [n for n in range(5) if n not in numbers]
    found = [one for one in shown.episodes if one.damaged]
    assert [one.episode for one in found] == numbers
    for one in found:
        assert why in one.damaged
    assert shown.total_frames in frames
    assert commands.show(recorded, False) == 0 and "DAMAGED" in capsys.readouterr().out
    assert commands.repair(recorded, drop=False, as_json=False) == 1
    output = "".join(capsys.readouterr())
    assert all(f"episode {number}" in output for number in numbers[:1])
    assert dataset_copies.compact(recorded, tmp_path / "copy", False) == 1
    assert sorted(path.name for path in tmp_path.iterdir()) == ["set"]
    assert hashes(recorded) == before, "the damaged files are unchanged"


def test_a_damaged_dataset_accepts_no_recording(recorded: Path) -> None:
    remove_video(recorded)
    with pytest.raises(DamagedError, match=r"episode 4 is damaged: .* is missing. Put the file back"):
        Dataset(recorded)


def test_nothing_is_put_aside_or_removed_while_an_episode_is_damaged(recorded: Path) -> None:
    """A file that no episode counts may be the missing part of the damaged episode."""
    aside = recorded / ".staging/uncounted/data/chunk-000/file-009.parquet"
    aside.parent.mkdir(parents=True)
    aside.write_bytes(b"once put aside")
    point_at_the_file_before(recorded)
    report = repair(recorded, drop=True)
    assert (report.moved_strays, report.dropped, [one.episode for one in report.damaged]) == ([], [], [3])
    assert (recorded / DATA.format(3)).exists() and aside.exists()


def test_an_episode_beside_a_damaged_one_is_repaired(recorded: Path) -> None:
    dataset = Dataset(recorded)
    episode = begin(dataset, "wave")
    fill(episode, [row(number) for number in range(40)])
    episode.abandon()
    dataset.close()
    remove_video(recorded)
    report = repair(recorded)
    assert [one.episode for one in report.repaired] == [5] and [one.episode for one in report.damaged] == [4]
    assert not report.is_sound and show(recorded).good == [0, 1, 2, 3]


def test_figures_that_are_lost_are_written_anew(recorded: Path) -> None:
    before = json.loads((recorded / "meta/stats.json").read_bytes())
    (recorded / "meta/stats.json").write_bytes(b"{")
    assert show(recorded).faults == ["meta/stats.json cannot be read, or lacks statistics"]
    assert repair(recorded).is_sound and show(recorded).faults == []
    after = json.loads((recorded / "meta/stats.json").read_bytes())
    assert after.keys() == before.keys() and after["action"]["count"] == [36]
    assert after["action"]["mean"] == pytest.approx(before["action"]["mean"])


@pytest.mark.parametrize("value", [None, {}, [], {"mean": [1.0, 2.0, 3.0]}])
def test_figures_of_one_feature_that_are_lost_are_written_anew(value: object, recorded: Path) -> None:
    path = recorded / "meta/stats.json"
    before = json.loads(path.read_bytes())
    changed = before | {"action": value}
    path.write_text(
        json.dumps(changed if value is not None else {k: v for k, v in before.items() if k != "action"})
    )
    assert "lacks statistics" in show(recorded).faults[0]
    assert repair(recorded).is_sound and show(recorded).faults == []
    assert json.loads(path.read_bytes())["action"].keys() == before["action"].keys()


def test_in_a_copy_damage_affects_only_its_own_episode(originals: dict[str, Original], tmp_path: Path) -> None:
    """In a copy, all episodes share one file."""
    root = tmp_path / "set"
    shutil.copytree(originals["copied"].root, root)
    group = pq.ParquetFile(root / DATA.format(0)).metadata.row_group(2).column(0)
    first = group.dictionary_page_offset or group.data_page_offset
    flip(root / DATA.format(0), first + group.total_compressed_size - 3)
    flip(root / VIDEO.format("front", 0), (root / VIDEO.format("front", 0)).stat().st_size - 3)
    shown = show(root)
    assert (shown.damaged, shown.good) == ([2, 4], [0, 1, 3])


# -- random damage


def exchange(one: Path, other: Path) -> None:
    kept = one.read_bytes()
    one.write_bytes(other.read_bytes())
    other.write_bytes(kept)


def flip(path: Path, at: int) -> None:
    with path.open("r+b") as file:
        file.seek(at)
        byte = file.read(1)
        file.seek(at)
        file.write(bytes([byte[0] ^ 0x10]))


def truncate(rng: random.Random, path: Path, other: Path) -> None:
    os.truncate(path, rng.randrange(path.stat().st_size))


def swap(rng: random.Random, path: Path, other: Path) -> None:
    exchange(path, other)


def zero(rng: random.Random, path: Path, other: Path) -> None:
    size = path.stat().st_size
    first = rng.randrange(size)
    with path.open("r+b") as file:
        file.seek(first)
        file.write(bytes(rng.randrange(size - first) + 1))


def flip_bytes(rng: random.Random, path: Path, other: Path) -> None:
    for _ in range(rng.choice((1, 1, 5, 50))):
        flip(path, rng.randrange(path.stat().st_size))


def delete(rng: random.Random, path: Path, other: Path) -> None:
    path.unlink()


def duplicate(rng: random.Random, path: Path, other: Path) -> None:
    shutil.copy(path, rng.choice((other, path.with_name(f"file-{rng.randrange(5, 2000):03d}{path.suffix}"))))


def reorder(rng: random.Random, path: Path, other: Path) -> None:
    if path.suffix == ".parquet":
        table = pq.read_table(path)
        order = rng.sample(range(table.num_rows), table.num_rows)
        pq.write_table(table.take(order), path)
    elif path.suffix == ".jsonl":
        lines = path.read_text().splitlines(keepends=True)
        path.write_text("".join(rng.sample(lines, len(lines))))
    else:
        data = path.read_bytes()
        at = rng.randrange(len(data))
        path.write_bytes(data[at:] + data[:at])


KINDS = (truncate, swap, zero, flip_bytes, delete, duplicate, reorder)


def hashes(root: Path) -> dict[str, str]:
    return {
        str(path.relative_to(root)): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(root.rglob("*"))
        if path.is_file()
    }


@pytest.mark.quick_cases(21)
@pytest.mark.parametrize("seed", range(SEEDS))
def test_after_any_damage_exactly_the_complete_episodes_are_reported_as_good(
    seed: int, originals: dict[str, Original], tmp_path: Path
) -> None:
    rng = random.Random(seed)
    of = originals[("recorded", "recorded", "copied", "older")[seed // len(KINDS) % 4]]
    root = tmp_path / "set"
    shutil.copytree(of.root, root)
    before = hashes(root)
    path = root / rng.choice(list(before))
    others = [root / name for name in before if name.endswith(path.suffix) and root / name != path]
    KINDS[seed % len(KINDS)](rng, path, rng.choice(others or [path]))
    after = hashes(root)
    changed = {name for name in before if after.get(name) != before[name]}

    has_info = "meta/info.json" not in changed
    try:
        judge(show(root), root, of, changed, has_info)
    except DatasetError:
        assert not has_info
    judge_repair(root, of, changed, has_info)
    judge_copy(root, of, tmp_path)


def judge(shown: Shown, root: Path, of: Original, changed: set[str], has_info: bool) -> None:
    affected = set().union(*(of.affected_by(name) for name in changed))
    whole = set(range(len(of.frames))) - affected
    if has_info:
        assert whole <= set(shown.good), "a complete episode is reported as damaged"
        assert whole | set(shown.good) | set(shown.damaged) == set(range(len(of.frames))) or shown.faults
    elif len(shown.episodes) != len(of.frames):
        assert shown.faults
    for one in shown.episodes:
        if one.episode in shown.good:
            assert one.frames == of.frames[one.episode] or shown.faults
            require_whole(root, of, one.episode)
        else:
            assert one.frames <= max(of.frames)
    assert shown.total_frames == sum(one.frames for one in shown.episodes)


def require_whole(root: Path, of: Original, number: int) -> None:
    """A file of another program has no checksum, so its frames are counted and not compared."""
    if of.has_checksums:
        found = contents_of(root, of.frames, number, of.data[number], of.videos[number])
        assert found == of.contents[number], f"{number} is reported as good, but differs from the recording"
    else:
        episodes = pq.read_table(root / of.data[number], columns=["episode_index"])["episode_index"].to_pylist()
        assert episodes == [number] * of.frames[number]


def judge_repair(root: Path, of: Original, changed: set[str], has_info: bool) -> None:
    """Check that undamaged episodes are unchanged. Success means that no episode is damaged."""
    try:
        code = commands.repair(root, drop=False, as_json=False)
    except Problem:
        code = 2
    affected = set().union(*(of.affected_by(name) for name in changed))
    for number in set(range(len(of.frames))) - affected if has_info else ():
        assert contents_of(root, of.frames, number, of.data[number], of.videos[number]) == of.contents[number]
    if code == 0:
        shown = show(root)
        assert not shown.damaged and not shown.faults and not shown.stray_files
        assert shown.good == list(range(len(of.frames)))


def judge_copy(root: Path, of: Original, tmp_path: Path) -> None:
    """Check that the copy has every frame, or does not exist."""
    copy = tmp_path / "copy"
    try:
        done = (compact if of.has_checksums else convert)(root, copy)
    except DatasetError:
        assert sorted(path.name for path in tmp_path.iterdir()) == ["set"]
        return
    assert (done.episodes, done.frames) == (len(of.frames), sum(of.frames))
    videos = tuple(sorted(str(path.relative_to(copy)) for path in copy.rglob("*.mp4")))
    for number in range(len(of.frames)):
        found = contents_of(copy, of.frames, number, DATA.format(0), videos)
        assert found == of.contents[number] or not of.has_checksums
