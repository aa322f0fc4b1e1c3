"""Write datasets in the layouts of LeRobot's versions 2.0 and 2.1, and as version 3 creates them."""

from __future__ import annotations

import json
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from .made import FRONT as CAMERA
from .made import scene

KEY = "observation.images.front"
JOINTS = ["shoulder_pan.pos", "elbow_flex.pos", "gripper.pos"]
LENGTHS = (9, 14, 6)
TASKS = ("wave", "put the cube down")


def write_video(path: Path, frames: int, fps: Fraction = Fraction(30), b_frames: int = 0) -> None:
    """Write a video with numbered pictures. ``b_frames`` pictures are decoded out of order."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with av.open(str(path), "w") as container:
        stream = container.add_stream("mpeg4", rate=fps)
        stream.width, stream.height, stream.pix_fmt = CAMERA.width, CAMERA.height, "yuv420p"
        stream.codec_context.max_b_frames = b_frames
        stream.codec_context.qmax = 4
        for number in range(frames):
            container.mux(stream.encode(av.VideoFrame.from_ndarray(scene(CAMERA, number), format="rgb24")))
        container.mux(stream.encode())


def features(channel_first: bool = False) -> dict[str, Any]:
    """Return features with nested names, and channels first, as in ported datasets."""
    shape = [3, CAMERA.height, CAMERA.width] if channel_first else [CAMERA.height, CAMERA.width, 3]
    names = ["channels", "height", "width"] if channel_first else ["height", "width", "channel"]
    numbers = ("frame_index", "episode_index", "index", "task_index")
    return {
        "action": {"dtype": "float32", "shape": [3], "names": {"motors": JOINTS}},
        "observation.state": {"dtype": "float32", "shape": [3], "names": {"motors": JOINTS}},
        KEY: {"dtype": "video", "shape": shape, "names": names, "video_info": {"video.codec": "mpeg4"}},
        "timestamp": {"dtype": "float32", "shape": [1], "names": None},
        **{name: {"dtype": "int64", "shape": [1], "names": None} for name in numbers},
    }


def write_older(
    root: Path, version: str = "v2.1", fps: float = 30, b_frames: int = 0, channel_first: bool = False
) -> None:
    """Write three episodes of version 2, each with a parquet file, a video and its JSON lines."""
    rows, stats = [], []
    first = 0
    for number, frames in enumerate(LENGTHS):
        task = number % len(TASKS)
        rows.append({"episode_index": number, "tasks": [TASKS[task]], "length": frames})
        table = _data(number, frames, first, task, fps)
        path = root / f"data/chunk-000/episode_{number:06d}.parquet"
        path.parent.mkdir(parents=True, exist_ok=True)
        pq.write_table(table, path)
        video = root / f"videos/chunk-000/{KEY}/episode_{number:06d}.mp4"
        write_video(video, frames, Fraction(str(fps)), b_frames)
        values = np.array(table["action"].to_pylist())
        statistics = {name: getattr(values, name)(0).tolist() for name in ("min", "max", "mean", "std")}
        stats.append({"episode_index": number, "stats": {"action": statistics | {"count": [frames]}}})
        first += frames
    meta = root / "meta"
    meta.mkdir()
    _lines(meta / "episodes.jsonl", rows)
    _lines(meta / "tasks.jsonl", [{"task_index": number, "task": task} for number, task in enumerate(TASKS)])
    if version == "v2.1":
        _lines(meta / "episodes_stats.jsonl", stats)
    info = {
        "codebase_version": version,
        "robot_type": "so100",
        "total_episodes": len(LENGTHS),
        "total_frames": first,
        "total_tasks": len(TASKS),
        "total_videos": len(LENGTHS),
        "total_chunks": 1,
        "chunks_size": 1000,
        "fps": fps,
        "splits": {"train": f"0:{len(LENGTHS)}"},
        "data_path": "data/chunk-{episode_chunk:03d}/episode_{episode_index:06d}.parquet",
        "video_path": "videos/chunk-{episode_chunk:03d}/{video_key}/episode_{episode_index:06d}.mp4",
        "features": features(channel_first),
        "license": "apache-2.0",
    }
    (meta / "info.json").write_text(json.dumps(info))


def _data(number: int, frames: int, first: int, task: int, fps: float) -> pa.Table:
    count = np.arange(frames)
    joints = np.stack([count + 100 * number, count * 0.5, -count], axis=1).astype(np.float32)
    return pa.table(
        {
            "action": joints.tolist(),
            "observation.state": (joints + 1).tolist(),
            "timestamp": (count / fps).astype(np.float32),
            "frame_index": count,
            "episode_index": np.full(frames, number),
            "index": first + count,
            "task_index": np.full(frames, task),
        },
        schema=pa.schema(
            {
                "action": pa.list_(pa.float32()),
                "observation.state": pa.list_(pa.float32()),
                "timestamp": pa.float32(),
                **{name: pa.int64() for name in ("frame_index", "episode_index", "index", "task_index")},
            }
        ),
    )


def _lines(path: Path, objects: list[dict[str, Any]]) -> None:
    path.write_text("".join(json.dumps(each) + "\n" for each in objects))


def create(root: Path, joints: list[str], cameras: dict[str, list[int]], fps: int = 30, **changed: Any) -> None:
    """Write a folder as ``LeRobotDataset.create`` of 0.4 and 0.6 does: with ``info.json`` only."""
    numbers = ("frame_index", "episode_index", "index", "task_index")
    names = ["height", "width", "channels"]
    info = {
        "codebase_version": "v3.0",
        "robot_type": "so101_follower",
        "total_episodes": 0,
        "total_frames": 0,
        "total_tasks": 0,
        "chunks_size": 1000,
        "data_files_size_in_mb": 100,
        "video_files_size_in_mb": 200,
        "fps": fps,
        "splits": {},
        "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
        "video_path": "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4",
        "features": {
            "action": {"dtype": "float32", "shape": [len(joints)], "names": joints},
            "observation.state": {"dtype": "float32", "shape": [len(joints)], "names": joints},
            **{
                f"observation.images.{name}": {"dtype": "video", "shape": shape, "names": names}
                for name, shape in cameras.items()
            },
            "timestamp": {"dtype": "float32", "shape": [1], "names": None},
            **{name: {"dtype": "int64", "shape": [1], "names": None} for name in numbers},
        },
    }
    (root / "meta").mkdir(parents=True)
    (root / "meta/info.json").write_text(json.dumps(info | changed))
