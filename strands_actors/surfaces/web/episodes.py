"""Read datasets and recordings for the page: lists, the positions of an episode, and its pictures.

All of this reads files, so it runs in threads. No robot is involved.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from pathlib import Path

import msgspec
import numpy as np

from strands_actors.contract.shown import harmless
from strands_actors.surfaces.recording.errors import RecordingError

from .types import driver_of

OURS = "strands_"
"""Prefix of a robot's type in a dataset of this package."""
MOST_FRAMES = 20_000
"""Longer episodes and recordings are thinned out to this many frames."""
PICTURE_WIDTH = 240

Units = Mapping[str, tuple[float, float]]
Row = list[float | None]


class Listed(msgspec.Struct, frozen=True):
    """A dataset or a recording in the list.

    Attributes:
        name: Name of its folder or file.
        is_dataset: False for a recording.
        about: A line about it: robot, number of episodes; or why it cannot be read.
    """

    name: str
    is_dataset: bool
    about: str


class ListedEpisode(msgspec.Struct, frozen=True):
    """An episode in the list. ``defects`` is empty for a good episode. ``cameras`` have pictures."""

    number: int
    task: str
    frames: int
    seconds: float
    defects: str
    cameras: list[str]


class Track(msgspec.Struct, frozen=True):
    """The positions of an episode or a recording over time.

    Attributes:
        robot_type: Type of the robot, whose model is drawn; empty if it is not known.
        task: The task.
        joints: Names of the joints.
        units: (zero, scale) by joint, to convert positions to radians or metres; empty if they are not known.
        times: Time of each frame in seconds.
        measured: The measured position of each joint, for each frame.
        commanded: The commanded position of each joint, for each frame.
    """

    robot_type: str
    task: str
    joints: tuple[str, ...]
    units: Units
    times: list[float]
    measured: list[Row]
    commanded: list[Row]


def listed(folder: Path) -> list[Listed]:
    """Return the datasets and recordings in a folder, the newest first."""
    if not folder.is_dir():
        return []
    entries = []
    for path in sorted(folder.iterdir(), key=lambda each: each.stat().st_mtime, reverse=True):
        if (path / "meta" / "info.json").is_file():
            entries.append(Listed(path.name, True, _about(path)))
        elif path.suffix == ".mcap":
            entries.append(Listed(path.name, False, f"{path.stat().st_size / 1e6:.1f} MB"))
    return entries


def _about(root: Path) -> str:
    from strands_actors.surfaces.dataset.layout import read_info

    try:
        info = read_info(root)
    except RecordingError as damage:
        return harmless(str(damage))
    if info is None:
        return "not a dataset"
    robot = harmless((info.robot_type or "").removeprefix(OURS))
    return f"{robot or 'robot not stated'}, {info.total_episodes or 0} episodes, {info.fps:g} fps"


def episodes_of(root: Path) -> list[ListedEpisode]:
    """Return the episodes of a dataset, the newest first.

    Raises:
        RecordingError: The dataset cannot be read.
    """
    from strands_actors.surfaces.dataset.index import Index
    from strands_actors.surfaces.dataset.layout import CAMERA

    index = Index(root)
    if index.info is None:
        return []
    fps = index.info.fps
    return [
        ListedEpisode(
            episode.index,
            harmless(episode.task),
            episode.frames,
            round(episode.frames / fps, 2) if fps else 0.0,
            episode.quality.as_text,
            sorted(key.removeprefix(CAMERA) for key in index.rows[episode.index].videos),
        )
        for episode in reversed(index.episodes)
    ]


def track_of_episode(root: Path, number: int) -> Track:
    """Return the positions of an episode.

    Raises:
        RecordingError: The episode does not exist, or cannot be read.
    """
    from strands_actors.surfaces.dataset.index import Index
    from strands_actors.surfaces.dataset.layout import STATE
    from strands_actors.surfaces.dataset.played import read_episode
    from strands_actors.surfaces.dataset.rows import frames_of
    from strands_actors.surfaces.dataset.tables import refuse_damage

    played = read_episode(root, number)
    index = Index(root)
    commanded: list[Row] = [list(row) for row in played.rows]
    measured = commanded
    feature = index.info.features.get(STATE) if index.info is not None else None
    if feature is not None:
        names = [name.removesuffix(".pos").removesuffix(".vel") for name in feature.flat_names]
        columns = [names.index(joint) for joint in played.joints if joint in names]
        if len(columns) == len(played.joints):
            row = index.rows[number]
            with refuse_damage(root / row.data):
                values = np.array(frames_of(root, row)[STATE].to_pylist(), dtype=np.float64)
            measured = [[_number(value) for value in line] for line in values[:, columns].tolist()]
    robot_type = played.robot_type.removeprefix(OURS)
    units = _units_of(robot_type) if played.units else {}
    times = [step / played.hz for step in range(len(commanded))]
    return _thinned(Track(robot_type, played.task, played.joints, units, times, measured, commanded))


def track_of_recording(file: Path) -> Track:
    """Return the positions in a recording.

    Raises:
        RecordingError: The file cannot be read.
    """
    from strands_actors.surfaces.recording.code import driver_from
    from strands_actors.surfaces.recording.file import entries_of, read
    from strands_actors.surfaces.recording.rows import Command, Journal, Seen
    from strands_actors.surfaces.recording.views import View

    recording = read(file)
    attached = recording.info.attached
    joints, view = tuple(attached.axes), View("wire", attached.axes, 0)
    times: list[float] = []
    measured: list[Row] = []
    commanded: list[Row] = []
    goal: dict[str, float | None] = {}
    for part in recording.parts:
        if not isinstance(part, Journal):
            continue
        for _, at_ns, row in view.rows(entries_of(part)):
            if isinstance(row, Command) and row.outcome == "accepted" and row.target:
                goal = row.target
            elif isinstance(row, Seen):
                times.append(at_ns / 1e9)
                measured.append([_number(row.position.get(joint)) for joint in joints])
                commanded.append([_number(goal.get(joint)) for joint in joints])
    driver = driver_from(attached)
    units = dict(zip(driver.axes, driver.model_units(), strict=True))
    since = [time_s - times[0] for time_s in times]
    return _thinned(Track(recording.info.kind, recording.info.robot, joints, units, since, measured, commanded))


def picture_of(root: Path, number: int, camera: str) -> bytes | None:
    """Return the first picture of an episode as a small JPEG; None if the camera took no picture.

    Raises:
        RecordingError: The dataset or the video cannot be read.
    """
    from strands_actors.surfaces.dataset.index import Index
    from strands_actors.surfaces.dataset.layout import CAMERA
    from strands_actors.surfaces.dataset.video import encode_image, pictures_of

    index = Index(root)
    row = index.rows.get(number)
    span = None if row is None else row.videos.get(CAMERA + camera)
    if span is None or index.info is None:
        return None
    first = itertools.islice(pictures_of(root / span.path), round(span.start_s * index.info.fps), None)
    picture = next(first, None)
    return None if picture is None else encode_image(picture, PICTURE_WIDTH)


def _units_of(robot_type: str) -> Units:
    driver = driver_of(robot_type)
    return {} if driver is None else dict(zip(driver.axes, driver.model_units(), strict=True))


def _number(value: float | None) -> float | None:
    return None if value is None or not math.isfinite(value) else round(value, 4)


def _thinned(track: Track) -> Track:
    step = -(-len(track.times) // MOST_FRAMES)
    if step <= 1:
        return track
    return msgspec.structs.replace(
        track,
        times=track.times[::step],
        measured=track.measured[::step],
        commanded=track.commanded[::step],
    )
