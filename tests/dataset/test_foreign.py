"""LeRobot's datasets of versions 2.0 and 2.1 are shown and converted. A new dataset accepts episodes."""

from __future__ import annotations

import json
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from strands_actors.surfaces.cli import dataset as commands
from strands_actors.surfaces.cli import dataset_copies
from strands_actors.surfaces.dataset.compact import compact, convert
from strands_actors.surfaces.dataset.dataset import Dataset
from strands_actors.surfaces.dataset.errors import DamagedError, DatasetError
from strands_actors.surfaces.dataset.repair import repair
from strands_actors.surfaces.dataset.report.measure import measure
from strands_actors.surfaces.dataset.show import show
from strands_actors.surfaces.dataset.video import look

from .foreign import JOINTS, KEY, LENGTHS, TASKS, create, write_older, write_video
from .made import FRONT, WRIST, add_episode, check, decoded, info_of


@pytest.fixture
def root(tmp_path: Path) -> Path:
    return tmp_path / "theirs"


def frames_of(root: Path, name: str) -> list[dict[str, Any]]:
    return [frame for path in sorted(root.glob(name)) for frame in pq.read_table(path).to_pylist()]


# -- versions 2.0 and 2.1


@pytest.mark.parametrize("version", ["v2.0", "v2.1"])
def test_an_older_version_is_shown(version: str, root: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_older(root, version, channel_first=True)
    shown = show(root)
    assert [(one.frames, one.task) for one in shown.episodes] == [(9, "wave"), (14, TASKS[1]), (6, "wave")]
    assert (shown.version, shown.good, shown.damaged, shown.faults) == (version, [0, 1, 2], [], [])
    assert (shown.joints, shown.cameras, shown.robot_type) == (JOINTS, {"front": "96x64 mpeg4"}, "so100")
    assert commands.show(root, False) == 0 and f"29 frames, {shown.bytes / 1e6:.1f} MB, {version}" in (
        capsys.readouterr().out
    )


@pytest.mark.parametrize(
    ("version", "fps", "b_frames"), [("v2.0", 30, 0), ("v2.1", 30, 0), ("v2.1", 29.97, 0), ("v2.1", 30, 2)]
)
def test_an_older_version_is_converted_frame_by_frame(
    version: str, fps: float, b_frames: int, root: Path, tmp_path: Path
) -> None:
    write_older(root, version, fps, b_frames)
    copy = tmp_path / "copy"
    done = convert(root, copy)
    assert (done.episodes, done.frames, done.files) == (3, sum(LENGTHS), 6)
    assert frames_of(copy, "data/*/*.parquet") == frames_of(root, "data/*/*.parquet")
    sources = [picture for path in sorted(root.rglob("*.mp4")) for _, picture in decoded(path)]
    (video,) = copy.rglob("*.mp4")
    written = decoded(video)
    assert len(written) == len(sources) == sum(LENGTHS)
    for number, ((at_s, picture), source) in enumerate(zip(written, sources, strict=True)):
        assert abs(at_s - number / fps) < 1e-6 and np.array_equal(picture, source), number
    shown = show(copy)
    assert (shown.good, shown.faults, shown.fps, shown.version) == ([0, 1, 2], [], fps, "v3.0")
    stats = json.loads((copy / "meta/stats.json").read_bytes())
    assert stats["action"]["count"] == [29] and stats["action"]["max"][0] == 205.0
    if b_frames == 0 and fps == 30:
        assert check(copy) == 3
    info = info_of(copy)
    assert info["license"] == "apache-2.0" and "total_videos" not in info and info["total_tasks"] == 2
    assert info["features"][KEY]["info"] == {"video.codec": "mpeg4"}


def test_a_video_of_reordered_pictures_is_one(tmp_path: Path) -> None:
    """Otherwise the test above shows nothing about the order of pictures."""
    write_video(tmp_path / "a.mp4", 9, Fraction(30), 2)
    seen = look(tmp_path / "a.mp4")
    assert (seen.count, round(seen.seconds * 30)) == (9, 8)
    assert [round(at * 30) for at, _ in decoded(tmp_path / "a.mp4")] == list(range(9))


@pytest.mark.parametrize(
    ("damage", "number", "why"),
    [
        (lambda root: (root / "data/chunk-000/episode_000001.parquet").unlink(), 1, "is missing"),
        (
            lambda root: write_video(root / f"videos/chunk-000/{KEY}/episode_000002.mp4", 5),
            2,
            "5 pictures of the episode",
        ),
        (lambda root: write_video(root / f"videos/chunk-000/{KEY}/episode_000000.mp4", 10), 0, "10 pictures"),
    ],
    ids=["no-data", "short-video", "long-video"],
)
def test_an_older_version_that_is_damaged_is_named_and_not_converted(
    damage: Any, number: int, why: str, root: Path, tmp_path: Path
) -> None:
    write_older(root)
    damage(root)
    shown = show(root)
    assert shown.damaged == [number] and why in shown.episodes[number].damaged
    before = sorted(tmp_path.rglob("*"))
    with pytest.raises(DamagedError, match=f"episode {number} is damaged: .*{why}"):
        convert(root, tmp_path / "copy")
    assert sorted(tmp_path.rglob("*")) == before
    assert dataset_copies.convert(root, tmp_path / "copy", False) == 1


def test_each_command_refuses_the_version_that_it_does_not_write(root: Path, tmp_path: Path) -> None:
    write_older(root)
    before = sorted(root.rglob("*"))
    for refused in (compact, lambda root, copy: Dataset(root), lambda root, copy: repair(root)):
        with pytest.raises(DatasetError, match=r"version v2.1.*dataset convert"):
            refused(root, tmp_path / "copy")
    assert sorted(root.rglob("*")) == before
    convert(root, tmp_path / "copy")
    with pytest.raises(DatasetError, match=r"version v3.0 already.*dataset compact"):
        convert(tmp_path / "copy", tmp_path / "again")
    compact(tmp_path / "copy", tmp_path / "again")
    assert check(tmp_path / "again") == 3


@pytest.mark.parametrize("name", ["tasks.jsonl", "episodes.jsonl", "episodes_stats.jsonl"])
@pytest.mark.parametrize("data", [b"", b"[]\n", b'{"task_index": 0, "task": null}\n', b"\xff\xfe\n", b"[" * 9999])
def test_an_invalid_table_of_an_older_version_is_named(name: str, data: bytes, root: Path) -> None:
    write_older(root)
    (root / "meta" / name).write_bytes(data)
    shown = show(root)
    if name == "episodes_stats.jsonl" and not data:
        assert shown.good == [0, 1, 2]  # the dataset has no figures yet
    else:
        assert shown.faults and all(str(root) in fault for fault in shown.faults)
        with pytest.raises(DamagedError, match=str(root)):
            convert(root, root.with_name("copy"))


def test_an_episode_without_a_task_in_its_row_has_the_task_of_its_frames(root: Path, tmp_path: Path) -> None:
    write_older(root)
    rows = [json.loads(line) for line in (root / "meta/episodes.jsonl").read_text().splitlines()]
    rows[0]["tasks"] = None
    del rows[1]["tasks"]
    (root / "meta/episodes.jsonl").write_text("\n".join(map(json.dumps, rows)))
    convert(root, tmp_path / "copy")
    assert [one.task for one in show(tmp_path / "copy").episodes] == ["wave", TASKS[1], "wave"]


# -- a new dataset


def test_a_dataset_that_lerobot_has_created_is_shown_and_recorded_into(root: Path) -> None:
    sizes = {"front": [FRONT.height, FRONT.width, 3], "wrist": [WRIST.height, WRIST.width, 3]}
    create(root, JOINTS, sizes)
    shown = show(root)
    assert (shown.total_episodes, shown.fps, shown.faults) == (0, 30, []) and shown.cameras["front"] == "96x64 "
    for frames in (5, 3):
        dataset = Dataset(root)
        add_episode(dataset, frames)
        dataset.close()
    assert check(root) == 2 and show(root).good == [0, 1]
    assert set(info_of(root)["features"]) >= {"requested_action", "age_ms", "observation.images.wrist"}


@pytest.mark.parametrize(
    ("changed", "why"),
    [
        ({"fps": 25}, "declares 25 fps, but this recording has 30"),
        ({"joints": ["a.pos", *JOINTS[1:]]}, "action is float32 .3. a.pos"),
        (
            {"cameras": {"front": [480, 640, 3], "wrist": [80, 64, 3]}},
            "front is video 640x480x3, not video 96x64x3",
        ),
        ({"cameras": {"top": [64, 96, 3]}}, "images.top is only in the dataset"),
    ],
)
def test_a_recording_of_something_else_than_was_declared_is_refused(
    changed: dict[str, Any], why: str, root: Path
) -> None:
    sizes = {"front": [FRONT.height, FRONT.width, 3], "wrist": [WRIST.height, WRIST.width, 3]}
    create(root, **{"joints": JOINTS, "cameras": sizes, **changed})
    dataset = Dataset(root)
    with pytest.raises(DatasetError, match=f"has no episode yet, and .*{why}"):
        add_episode(dataset, 3)
    assert info_of(root)["total_episodes"] == 0


def test_files_of_a_dataset_that_counts_no_episode_stay(root: Path) -> None:
    """LeRobot has written these files and has not finished the episode."""
    create(root, JOINTS, {})
    path = root / "data/chunk-000/file-000.parquet"
    path.parent.mkdir(parents=True)
    path.write_bytes(b"PAR1 and no footer")
    with pytest.raises(DatasetError, match=r"has no episode in its meta/info.json, but files"):
        Dataset(root)
    assert path.exists() and show(root).stray_files == ["data/chunk-000/file-000.parquet"]


def test_a_fractional_rate_is_kept_and_not_recorded_into(root: Path, tmp_path: Path) -> None:
    write_older(root, fps=29.97)
    convert(root, tmp_path / "copy")
    assert info_of(tmp_path / "copy")["fps"] == 29.97
    dataset = Dataset(tmp_path / "copy")
    with pytest.raises(DatasetError, match=r"rate is 29.97 fps, and a recording needs a whole number"):
        dataset.codec_for(None)


# -- names in files


@pytest.mark.parametrize("key", ["observation.images.x/../../../PWN", "../x", "/etc/x", "a\\b", "x\n"])
def test_a_name_in_a_file_leads_nowhere_else(key: str, root: Path, tmp_path: Path) -> None:
    write_older(root)
    info = info_of(root)
    info["features"][key] = info["features"].pop(KEY)
    (root / "meta/info.json").write_text(json.dumps(info))
    before = sorted(tmp_path.rglob("*"))
    for command in (show, lambda root: convert(root, tmp_path / "a/b/copy"), Dataset):
        with pytest.raises(DatasetError, match="cannot be the name of a folder"):
            command(root)
    assert sorted(tmp_path.rglob("*")) == before


@pytest.mark.parametrize("name", ["data_path", "video_path"])
def test_a_path_in_a_file_is_not_followed(name: str, root: Path) -> None:
    write_older(root)
    info = info_of(root) | {name: "/etc/{episode_index}"}
    (root / "meta/info.json").write_text(json.dumps(info))
    with pytest.raises(DatasetError, match=r"the file names '/etc/.* are not supported"):
        show(root)


def test_texts_of_a_file_are_shown_without_interpretation(root: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A task's text is shown without interpreting markup or terminal commands."""
    write_older(root)
    rows = [json.loads(line) for line in (root / "meta/episodes.jsonl").read_text().splitlines()]
    for row in rows:
        row["tasks"] = ["[/bold] \x1b[2J wave"]
    (root / "meta/episodes.jsonl").write_text("\n".join(map(json.dumps, rows)))
    assert commands.show(root, False) == 0
    out = capsys.readouterr().out
    assert "[/bold]" in out and "\x1b[2J" not in out


# -- pictures in parquet


def test_pictures_that_stand_in_a_parquet_are_converted(root: Path, tmp_path: Path) -> None:
    write_older(root, "v2.0")
    info = info_of(root)
    info["features"][KEY] |= {"dtype": "image"}
    (root / "meta/info.json").write_text(json.dumps(info))
    png = _png(tmp_path)
    for path in sorted(root.glob("data/*/*.parquet")):
        table = pq.read_table(path)
        cells = pa.array([{"bytes": png, "path": None}] * table.num_rows)
        pq.write_table(table.append_column(KEY, cells), path)
    done = convert(root, tmp_path / "copy")
    assert (done.frames, done.files) == (29, 5)
    frames = frames_of(tmp_path / "copy", "data/*/*.parquet")
    assert len(frames) == 29 and {frame[KEY]["bytes"] for frame in frames} == {png}
    stats = json.loads((tmp_path / "copy/meta/stats.json").read_bytes())
    assert stats[KEY]["count"] == [29] and np.shape(stats[KEY]["mean"]) == (3, 1, 1)
    assert [len(episode.pictures["front"]) for episode in measure(tmp_path / "copy").episodes] == [3, 3, 3]


def _png(folder: Path) -> bytes:
    import av

    from .made import scene

    with av.open(str(folder / "one.png"), "w", format="image2") as container:
        stream = container.add_stream("png", rate=1)
        stream.width, stream.height, stream.pix_fmt = FRONT.width, FRONT.height, "rgb24"
        container.mux(stream.encode(av.VideoFrame.from_ndarray(scene(FRONT, 3), format="rgb24")))
        container.mux(stream.encode())
    return (folder / "one.png").read_bytes()
