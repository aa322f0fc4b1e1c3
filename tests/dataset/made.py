"""Make episodes without a robot. Their scene changes with the number of the picture."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import av
import numpy as np
import pyarrow.parquet as pq

from strands_actors.surfaces.dataset.dataset import Dataset
from strands_actors.surfaces.dataset.layout import CameraShape, Layout
from strands_actors.surfaces.dataset.staging import Picture, Row, StagedEpisode, new_folder

FPS = 30
JOINTS = ("shoulder_pan.pos", "elbow_flex.pos", "gripper.pos")
FRONT = CameraShape("front", 64, 96)
WRIST = CameraShape("wrist", 80, 64)
LAYOUT = Layout("strands_so101", FPS, JOINTS, (FRONT, WRIST))


def scene(camera: CameraShape, number: int) -> Picture:
    """Return a picture with a white bar. The bar's position encodes the number of the picture."""
    picture = np.full((camera.height, camera.width, 3), 40, np.uint8)
    column = bar(camera, number)
    picture[:, column : column + 8] = 255
    return picture


def bar(camera: CameraShape, number: int) -> int:
    return number * 3 % (camera.width - 8)


def row(number: int, gap: int = 0, stale: tuple[str, ...] = ()) -> Row:
    state = tuple(10 * joint + math.sin(number / 7 + joint) for joint in range(3))
    moved = tuple(value + 0.5 for value in state)
    asked = tuple(value + 0.75 for value in state)
    return Row(state, moved, asked, (4.0 + number % 3, 11.0 + number % 5, 20.0), gap, stale)


def begin(dataset: Dataset, task: str = "put the cube down", layout: Layout = LAYOUT) -> StagedEpisode:
    return StagedEpisode(dataset.storage, new_folder(dataset.staging), layout, task)


def fill(episode: StagedEpisode, rows: Sequence[Row]) -> None:
    for each in rows:
        number = episode.frames
        episode.add(each, {camera.name: scene(camera, number) for camera in episode.layout.cameras})


def add_episode(dataset: Dataset, frames: int, task: str = "put the cube down") -> None:
    episode = begin(dataset, task)
    fill(episode, [row(number) for number in range(frames)])
    episode.finish()
    dataset.commit(episode.folder)


def info_of(root: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads((root / "meta/info.json").read_bytes())
    return found


def decoded(path: Path) -> list[tuple[float, Picture]]:
    """Return each frame with its time."""
    with av.open(str(path)) as container:
        return [(frame.time or 0.0, frame.to_ndarray(format="rgb24")) for frame in container.decode(video=0)]


def check(root: Path) -> int:
    """Read all files and pictures of the dataset as LeRobot does. Return the number of episodes."""
    info = info_of(root)
    data = sorted(root.glob("data/*/*.parquet"))
    index = [pq.read_table(path) for path in sorted(root.glob("meta/episodes/*/*.parquet"))]
    rows = [each for table in index for each in table.to_pylist()]
    frames = [each for path in data for each in pq.read_table(path).to_pylist()]
    assert [each["episode_index"] for each in rows] == list(range(info["total_episodes"]))
    assert len({table.schema.remove_metadata() for table in index}) <= 1
    assert [frame["index"] for frame in frames] == list(range(info["total_frames"]))
    tasks = {each["task_index"]: each for each in pq.read_table(root / "meta/tasks.parquet").to_pylist()}
    assert len(tasks) >= info["total_tasks"]
    videos = [key for key, feature in info["features"].items() if feature["dtype"] == "video"]
    for each in rows:
        mine = frames[each["dataset_from_index"] : each["dataset_to_index"]]
        assert len(mine) == each["length"]
        for number, frame in enumerate(mine):
            assert frame["frame_index"] == number and frame["episode_index"] == each["episode_index"]
            assert frame["timestamp"] == np.float32(number / info["fps"])
            assert tasks[frame["task_index"]]["__index_level_0__"] in each["tasks"]
            assert set(frame) == set(info["features"]) - set(videos)
        for key in videos:
            _check_video(root, each, key, info)
    return len(rows)


def _check_video(root: Path, each: dict[str, Any], key: str, info: dict[str, Any]) -> None:
    place = {name: each[f"videos/{key}/{name}"] for name in ("chunk_index", "file_index")}
    pictures = decoded(root / info["video_path"].format(video_key=key, **place))
    first = round(each[f"videos/{key}/from_timestamp"] * info["fps"])
    assert each[f"videos/{key}/from_timestamp"] == first / info["fps"]
    mine = pictures[first : first + each["length"]]
    assert len(mine) == each["length"]
    height, width, _ = info["features"][key]["shape"]
    camera = CameraShape(key, height, width)
    for number, (at_s, picture) in enumerate(mine):
        assert at_s == (first + number) / info["fps"]
        column = bar(camera, number)
        assert picture[:, column + 2 : column + 6].mean() > 180, (key, number)
