"""The files of a dataset have LeRobot's names, types and times. Each is complete or absent, and files of no
counted episode are put aside."""

from __future__ import annotations

import json
import os
from pathlib import Path

import msgspec
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from strands_actors.surfaces.dataset.dataset import STRAYS, Dataset
from strands_actors.surfaces.dataset.errors import DatasetError
from strands_actors.surfaces.dataset.index import Index
from strands_actors.surfaces.dataset.layout import CameraShape, Layout
from strands_actors.surfaces.dataset.show import show
from strands_actors.surfaces.dataset.staging import FINISHED, Row, StagedEpisode
from strands_actors.surfaces.dataset.statistics import PictureStatistics, aggregate, of_column
from strands_actors.surfaces.dataset.storage import Storage
from strands_actors.surfaces.dataset.video import CODECS, DEFAULT, Encoder

from .made import FRONT, LAYOUT, add_episode, begin, check, fill, info_of, row, scene


@pytest.fixture
def root(tmp_path: Path) -> Path:
    return tmp_path / "set"


def files(root: Path) -> set[str]:
    return {str(path.relative_to(root)) for path in root.rglob("*") if path.is_file()}


def test_each_episode_is_one_parquet_one_video_a_camera_and_one_row(root: Path) -> None:
    dataset = Dataset(root)
    for frames, task in ((20, "put the cube down"), (31, "wave"), (7, "put the cube down")):
        add_episode(dataset, frames, task)
    dataset.close()
    assert check(root) == 3
    numbered = [f"chunk-000/file-{number:03d}" for number in range(3)]
    assert files(root) == {
        "meta/info.json", "meta/stats.json", "meta/tasks.parquet",
        *(f"data/{name}.parquet" for name in numbered),
        *(f"meta/episodes/{name}.parquet" for name in numbered),
        *(f"videos/observation.images.{camera}/{name}.mp4" for name in numbered for camera in ("front", "wrist")),
    }  # fmt: skip
    info = info_of(root)
    assert (info["total_episodes"], info["total_frames"], info["total_tasks"]) == (3, 58, 2)
    assert info["codebase_version"] == "v3.0" and info["splits"] == {"train": "0:3"} and info["fps"] == 30
    assert info["robot_type"] == "strands_so101"
    assert info["features"]["observation.images.front"]["info"]["video.codec"] == DEFAULT


def test_a_new_one_is_its_owners_alone(root: Path) -> None:
    before = os.umask(0)
    try:
        dataset = Dataset(root)
        add_episode(dataset, 3)
        dataset.close()
    finally:
        os.umask(before)
    assert root.stat().st_mode & 0o777 == 0o700
    root.chmod(0o755)
    Dataset(root).close()
    assert root.stat().st_mode & 0o777 == 0o755, "an existing folder keeps its mode"


def test_the_written_frames_are_read_back(root: Path) -> None:
    dataset = Dataset(root)
    add_episode(dataset, 40)
    table = pq.read_table(root / "data/chunk-000/file-000.parquet")
    for number, each in enumerate(table.to_pylist()):
        given = row(number)
        for name, values in (
            ("observation.state", given.state),
            ("action", given.action),
            ("requested_action", given.requested),
            ("age_ms", given.age_ms),
        ):
            assert each[name] == [np.float32(value) for value in values]
    assert table.schema.field("action").type == pa.list_(pa.float32(), 3)
    assert info_of(root)["features"]["age_ms"]["names"] == ["state", "front", "wrist"]


def test_a_policy_trained_on_a_dataset_needs_only_inputs_that_a_robot_has(root: Path) -> None:
    """LeRobot uses each feature that begins with ``observation`` as an input of a policy, and each that begins
    with ``action`` as an output. No robot has an ``observation.age_ms``."""
    add_episode(Dataset(root), 3)
    names = info_of(root)["features"]
    inputs = {name for name in names if name.startswith("observation")}
    assert inputs == {"observation.state", "observation.images.front", "observation.images.wrist"}
    assert {name for name in names if name.startswith("action")} == {"action"}


def test_no_time_drifts_however_long_a_dataset_becomes(root: Path) -> None:
    dataset = Dataset(root)
    for _ in range(3):
        add_episode(dataset, 33)
    for number in range(3):
        table = pq.read_table(root / f"data/chunk-000/file-{number:03d}.parquet")
        assert table["timestamp"].to_pylist() == [np.float32(frame / 30) for frame in range(33)]
        (found,) = pq.read_table(root / f"meta/episodes/chunk-000/file-{number:03d}.parquet").to_pylist()
        assert found["videos/observation.images.front/from_timestamp"] == 0.0
        assert found["videos/observation.images.front/to_timestamp"] == 33 / 30


def test_a_robot_with_one_axis_and_no_camera_has_numbers_for_vectors(root: Path) -> None:
    """LeRobot writes it this way, and its loader requires it."""
    dataset = Dataset(root)
    episode = begin(dataset, layout=Layout("strands_gripper", 10, ("gripper.pos",)))
    for number in range(5):
        episode.add(Row((number,), (number,), (number,), (1.0,)), {})
    episode.finish()
    dataset.commit(episode.folder)
    table = pq.read_table(root / "data/chunk-000/file-000.parquet")
    assert table.schema.field("action").type == pa.float32()
    assert table.schema.field("age_ms").type == pa.float32()
    assert table["action"].to_pylist() == [0, 1, 2, 3, 4]
    assert check(root) == 1


@pytest.mark.parametrize("codec", CODECS)
def test_every_codec_keeps_every_picture(root: Path, codec: str) -> None:
    dataset = Dataset(root)
    episode = begin(dataset, layout=Layout("strands_so101", 30, LAYOUT.joints, (FRONT,), codec))
    for number in range(25):
        each = row(number)
        episode.add(Row(each.state, each.action, each.requested, each.age_ms[:2]), {"front": scene(FRONT, number)})
    episode.finish()
    dataset.commit(episode.folder)
    assert check(root) == 1
    assert info_of(root)["features"]["observation.images.front"]["info"]["video.codec"] == codec


@pytest.mark.parametrize(
    ("camera", "codec", "message"),
    [
        (CameraShape("a", 480, 641), "av1", "even width and height"),
        (CameraShape("a", 48, 64), "av1", "64 pixels or more"),
        (CameraShape("a", 64, 64), "h264", "Use av1 or mpeg4"),
    ],
)
def test_a_format_that_no_encoder_accepts_is_refused(
    root: Path, camera: CameraShape, codec: str, message: str
) -> None:
    with pytest.raises(DatasetError, match=message):
        begin(Dataset(root), layout=Layout("r", 30, ("a.pos",), (camera,), codec))


def test_marks_name_missing_and_late_values(root: Path) -> None:
    dataset = Dataset(root)
    episode = begin(dataset)
    fill(episode, [row(0), row(1, gap=4), row(2, stale=("wrist",)), row(3, stale=("state", "wrist"))])
    episode.finish(gap=2)
    dataset.commit(episode.folder)
    add_episode(dataset, 5)
    dataset.close()
    first, second = Index(root).episodes
    assert (first.quality.gaps, first.quality.stale, first.quality.repaired) == (6, {"state": 1, "wrist": 2}, False)
    assert first.quality.as_text == "6 frames missing, state late in 1 frames, wrist late in 2 frames"
    assert second.quality.as_text == "" and second.quality.began


# -- figures


def test_figures_of_a_column_and_of_all_episodes() -> None:
    rng = np.random.default_rng(3)
    parts = [rng.normal(at, 2.0, (count, 2)) for at, count in ((0.0, 50), (5.0, 200))]
    merged = aggregate([{"a": of_column(part)} for part in parts])["a"]
    whole = of_column(np.concatenate(parts))
    for name in ("min", "max", "mean", "std", "count"):
        assert np.allclose(merged[name], whole[name]), name


def test_figures_without_quantiles_are_merged_as_they_are() -> None:
    """Such figures come from another program's dataset that is continued or copied here."""
    parts = [of_column(np.full((count, 1), float(count))) for count in (2, 6)]
    for part in parts:
        del part["q50"]
    merged = aggregate([{"a": part} for part in parts])["a"]
    assert merged["mean"] == [5.0] and "q50" not in merged and "q01" in merged


def test_figures_of_pictures_are_those_of_their_pixels() -> None:
    rng = np.random.default_rng(4)
    pictures = [rng.integers(10, 200, (60, 80, 3), dtype=np.uint8) for _ in range(3)]
    statistics = PictureStatistics()
    for picture in pictures:
        statistics.add(picture)
    pixels = np.concatenate([picture.reshape(-1, 3) for picture in pictures]) / 255
    found = statistics.statistics()
    assert np.allclose(np.ravel(found["mean"]), pixels.mean(0)) and np.allclose(
        np.ravel(found["std"]), pixels.std(0)
    )
    assert np.allclose(np.ravel(found["min"]), pixels.min(0)) and np.allclose(np.ravel(found["max"]), pixels.max(0))
    assert np.allclose(np.ravel(found["q50"]), np.quantile(pixels, 0.5, axis=0), atol=0.006)
    assert np.array(found["mean"]).shape == (3, 1, 1) and found["count"] == [3]


# -- files of no counted episode


class PowerCut(Storage):
    """Simulate a power cut just before the n-th file gets its final name."""

    def __init__(self, after: int) -> None:
        self.after = after

    def place(self, staged: Path, final: Path) -> None:
        self.after -= 1
        if self.after < 0:
            raise KeyboardInterrupt
        super().place(staged, final)


@pytest.mark.parametrize("after", range(10))
def test_a_commit_that_was_cut_off_anywhere_loses_nothing_and_leaves_nothing(root: Path, after: int) -> None:
    dataset = Dataset(root)
    add_episode(dataset, 12)
    episode = begin(dataset, "wave")
    fill(episode, [row(number) for number in range(9)])
    episode.finish()
    dataset.storage = PowerCut(after)
    counted = 1
    try:
        dataset.commit(episode.folder)
        counted = 2
    except KeyboardInterrupt:
        assert info_of(root)["total_episodes"] == 1
    dataset.close()

    again = Dataset(root)
    assert len(again.episodes) == 2 and len(again.recovered) == 2 - counted
    assert check(root) == 2
    assert not any(again.staging.rglob("*")), "nothing is left"
    add_episode(again, 4)
    again.close()
    assert check(root) == 3 and not (root / ".staging").exists()
    assert json.loads((root / "meta/stats.json").read_bytes())["action"]["count"] == [25]


def test_a_file_that_no_episode_counts_is_put_aside_before_the_next_episode(root: Path) -> None:
    dataset = Dataset(root)
    add_episode(dataset, 12)
    dataset.close()
    stranger = root / "data/chunk-000/file-001.parquet"
    os.link(root / "data/chunk-000/file-000.parquet", stranger)
    again = Dataset(root)
    assert again.moved_strays == ["data/chunk-000/file-001.parquet"] and not stranger.exists()
    assert (root / ".staging" / STRAYS / "data/chunk-000/file-001.parquet").exists(), "not ours: kept"
    assert check(root) == 1


@pytest.mark.parametrize(
    "name", ["data/train/mine.parquet", "videos/a/b/mine.mp4", "data/chunk-000/file-000.parquet"]
)
@pytest.mark.parametrize("staging", [False, True])
def test_a_folder_with_files_of_other_programs_is_refused_and_not_changed(
    root: Path, name: str, staging: bool
) -> None:
    """The last case is a dataset that has lost its ``info.json``."""
    (root / name).parent.mkdir(parents=True)
    (root / name).write_bytes(b"precious")
    (root / "meta").mkdir()
    (root / "meta/notes.staged").write_bytes(b"precious")
    if staging:
        (root / ".staging").mkdir()
    before = files(root)
    with pytest.raises(DatasetError, match=f"has no meta/info.json, but files .*: {name} .1 files.. Give a new"):
        Dataset(root)
    assert files(root) == before == {name, "meta/notes.staged"}


def test_only_files_with_names_of_ours_are_put_aside_and_no_file_put_aside_is_lost(
    root: Path,
) -> None:
    dataset = Dataset(root)
    add_episode(dataset, 3)
    dataset.close()
    mine = ("data/train/mine.parquet", "meta/mine.staged", "videos/a/b/mine.mp4")
    for name in mine:
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_bytes(b"precious")
    for text in ("first", "second"):
        (root / "data/chunk-000/file-001.parquet").write_text(text)
        again = Dataset(root)
        again.close()
        assert again.moved_strays == ["data/chunk-000/file-001.parquet"]
    assert files(root) >= set(mine)
    aside = root / ".staging" / STRAYS / "data/chunk-000"
    assert [path.read_text() for path in sorted(aside.iterdir())] == ["second", "first"]
    assert show(root).strange == ["data/train/mine.parquet", "videos/a/b/mine.mp4"] and not show(root).stray_files


def test_a_folder_of_an_episode_that_is_counted_already_goes(root: Path) -> None:
    class Keeps(Storage):
        def remove(self, path: Path) -> None:
            raise KeyboardInterrupt

    dataset = Dataset(root)
    episode = begin(dataset)
    fill(episode, [row(0), row(1)])
    episode.finish()
    dataset.storage = Keeps()
    with pytest.raises(KeyboardInterrupt):
        dataset.commit(episode.folder)
    dataset.close()
    assert info_of(root)["total_episodes"] == 1 and episode.folder.exists()
    again = Dataset(root)
    assert len(again.episodes) == 1 and not again.recovered and not episode.folder.exists()


def test_a_folder_that_was_being_removed_means_nothing(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    dataset = Dataset(root)
    episode = begin(dataset)
    fill(episode, [row(0), row(1)])
    episode.finish()

    def killed(path: Path) -> None:
        (path / "frames.arrows").unlink()
        raise KeyboardInterrupt

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr("strands_actors.surfaces.dataset.storage.shutil.rmtree", killed)
        dataset.commit(episode.folder)
    dataset.close()
    again = Dataset(root)
    assert len(again.episodes) == 1 and not again.recovered and not any(again.staging.iterdir())


def test_a_damaged_finished_episode_does_not_prevent_recording(root: Path) -> None:
    dataset = Dataset(root)
    episode = begin(dataset)
    fill(episode, [row(0), row(1)])
    episode.finish()
    os.truncate(episode.folder / "front.mp4", 10)
    dataset.close()
    again = Dataset(root)
    assert again.unfinished() == [episode.folder]
    add_episode(again, 4)
    assert check(root) == 1


def test_an_unfinished_episode_stays_in_staging(root: Path) -> None:
    dataset = Dataset(root)
    fill(episode := begin(dataset), [row(number) for number in range(40)])
    episode.abandon()
    dataset.close()
    again = Dataset(root)
    assert again.unfinished() == [episode.folder] and again.episodes == []
    assert not (episode.folder / FINISHED).exists()


# -- one writer


def test_one_writer_at_a_time(root: Path) -> None:
    dataset = Dataset(root)
    with pytest.raises(DatasetError, match="another process writes"):
        Dataset(root)
    dataset.close()
    Dataset(root).close()


@pytest.mark.parametrize("replaced", [False, True])
def test_a_folder_that_was_moved_away_gets_no_episode(root: Path, tmp_path: Path, replaced: bool) -> None:
    """A USB stick that is removed leaves its mount point, an empty folder of the same name."""
    dataset = Dataset(root)
    add_episode(dataset, 3)
    root.rename(tmp_path / "moved")
    if replaced:
        root.mkdir()
    with pytest.raises(DatasetError, match="was moved, or its disk was unmounted"):
        add_episode(dataset, 4)
    with pytest.raises(DatasetError, match="was moved, or its disk was unmounted"):
        dataset.free_bytes()
    assert len(dataset.episodes) == 1 and not (root / "meta").exists() and check(tmp_path / "moved") == 1
    (folder,) = (root / ".staging").iterdir()
    assert (folder / FINISHED).exists(), "later recordings are not lost"


@pytest.mark.parametrize(
    ("other", "message"),
    [
        (Layout("strands_koch", 30, LAYOUT.joints, LAYOUT.cameras), "robot_type strands_so101, but this recording"),
        (Layout("strands_so101", 20, LAYOUT.joints, LAYOUT.cameras), "fps 30, but this recording has 20"),
        (Layout("strands_so101", 30, LAYOUT.joints, (FRONT,)), "other features"),
        (Layout("strands_so101", 30, ("a.pos", "b.pos", "c.pos"), LAYOUT.cameras), "other features: action is"),
    ],
)  # fmt: skip
def test_another_kind_of_episode_is_refused(root: Path, other: Layout, message: str) -> None:
    dataset = Dataset(root)
    add_episode(dataset, 3)
    with pytest.raises(DatasetError, match=message):
        dataset.require(other)


def test_a_codec_that_is_named_is_the_datasets_or_refused(root: Path) -> None:
    dataset = Dataset(root)
    assert dataset.codec_for(None) == "av1" and dataset.codec_for("mpeg4") == "mpeg4"
    episode = begin(dataset, layout=msgspec.structs.replace(LAYOUT, codec="mpeg4"))
    fill(episode, [row(number) for number in range(3)])
    episode.finish()
    dataset.commit(episode.folder)
    dataset.close()
    again = Dataset(root)
    assert again.codec_for(None) == again.codec_for("mpeg4") == "mpeg4"
    with pytest.raises(DatasetError, match="has videos with the codec mpeg4, not av1"):
        again.codec_for("av1")


IN_DEGREES = ("deg", "deg", "percent")


def test_the_units_stand_beside_the_names_and_another_unit_is_refused(root: Path) -> None:
    """The same axis names of one robot may count in radians, in degrees or in fractions of a range."""
    layout = msgspec.structs.replace(LAYOUT, units=IN_DEGREES)
    dataset = Dataset(root)
    episode = begin(dataset, layout=layout)
    fill(episode, [row(number) for number in range(3)])
    episode.finish()
    dataset.commit(episode.folder)
    dataset.close()
    features = info_of(root)["features"]
    for vector in ("action", "requested_action", "observation.state"):
        assert features[vector]["units"] == list(IN_DEGREES)
    assert "units" not in features["age_ms"]
    again = Dataset(root)
    assert again.require(layout) == layout
    with pytest.raises(DatasetError, match="action is in deg, deg, percent, not in rad, rad, percent"):
        again.require(msgspec.structs.replace(LAYOUT, units=("rad", "rad", "percent")))


def test_a_dataset_without_units_goes_on_and_has_them_from_then_on(root: Path) -> None:
    dataset = Dataset(root)
    add_episode(dataset, 3)
    dataset.close()
    assert "units" not in info_of(root)["features"]["action"]
    dataset = Dataset(root)
    episode = begin(dataset, layout=dataset.require(msgspec.structs.replace(LAYOUT, units=IN_DEGREES)))
    fill(episode, [row(number) for number in range(3)])
    episode.finish()
    dataset.commit(episode.folder)
    assert info_of(root)["features"]["action"]["units"] == list(IN_DEGREES)
    assert check(root) == 2


OLDER = '{"codebase_version": "v2.1", "fps": 30, "features": {}}'


@pytest.mark.parametrize(
    ("damage", "expected"),
    [
        (lambda root: (root / "meta/info.json").write_bytes(b"{"), "damaged"),
        (lambda root: (root / "meta/info.json").write_text(OLDER), "version v2.1.*dataset convert"),
        (lambda root: (root / "data/chunk-000/file-000.parquet").unlink(), "is missing"),
        (lambda root: (root / "meta/episodes/chunk-000/file-000.parquet").unlink(), "0: the index has no row"),
        (lambda root: (root / "meta/tasks.parquet").write_bytes(b"PAR1"), "cannot be read"),
    ],
)  # fmt: skip
def test_a_damaged_dataset_is_refused_and_not_touched(root: Path, damage: object, expected: str) -> None:
    dataset = Dataset(root)
    add_episode(dataset, 3)
    dataset.close()
    damage(root)  # type: ignore[operator]
    before = files(root)
    with pytest.raises(DatasetError, match=expected):
        Dataset(root)
    assert files(root) == before
    with pytest.raises(DatasetError, match=expected):  # the lock is free again
        Dataset(root)


def test_an_episode_of_no_frame_is_refused(root: Path) -> None:
    dataset = Dataset(root)
    episode = StagedEpisode(dataset.storage, dataset.staging / "episode-1", LAYOUT, "nothing")
    episode.finish()
    with pytest.raises(DatasetError, match="no complete frame"):
        dataset.commit(episode.folder)
    assert not dataset.episodes and episode.folder.exists()


@pytest.mark.parametrize("codec", CODECS)
def test_an_encoder_is_run_as_its_caller_is(codec: str, tmp_path: Path) -> None:
    """If root runs SVT-AV1, it takes SCHED_FIFO 99 and leaves no processor for the stop of a robot."""
    before = set(os.listdir("/proc/self/task"))

    def policies() -> set[int]:
        """Return the scheduling policies of this thread and of the encoder's threads."""
        threads = {*os.listdir("/proc/self/task")} - before
        return {os.sched_getscheduler(0), *(os.sched_getscheduler(int(thread)) for thread in threads)}

    encoder = Encoder(tmp_path / "front.mp4", FRONT, 30, codec)
    assert policies() == {os.SCHED_OTHER}
    for number in range(10):
        encoder.add(scene(FRONT, number))
    assert policies() == {os.SCHED_OTHER}
    encoder.finish()
