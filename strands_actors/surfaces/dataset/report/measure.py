"""Read every frame and picture of a dataset, and describe its episodes and their unusual figures."""

from __future__ import annotations

import base64
import io
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping
from itertools import islice
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from strands_actors.surfaces.dataset.check import check
from strands_actors.surfaces.dataset.compact import open_newest
from strands_actors.surfaces.dataset.errors import DatasetError
from strands_actors.surfaces.dataset.index import Index
from strands_actors.surfaces.dataset.info import Info
from strands_actors.surfaces.dataset.layout import ACTION, CAMERA, STATE
from strands_actors.surfaces.dataset.rows import EpisodeRow, episodes_of
from strands_actors.surfaces.dataset.tables import is_list
from strands_actors.surfaces.dataset.video import decode_image, encode_image, pictures_of

from .figures import Motion, Numbers, Pictures, motion_of
from .findings import Finding, Kind, find_by_joint, find_counts, find_equal, find_outliers

SHOWN = 3
"""Pictures of an episode and camera on the page: the first, one in the middle and the last."""
WIDTH = 160
RANGE_SHARE = 0.02
"""Least usual difference of an episode's range, as a share of the joint's range in the dataset."""
UNUSED_SHARE = 1e-9
STILL_S = 0.5
"""Least time with equal pictures or readings that is a finding, in seconds. A camera may be slower than ``fps``."""


class Joint(msgspec.Struct, frozen=True):
    """A joint: its range in the whole dataset, and the range of most episodes (their 10 % and 90 % quantiles)."""

    name: str
    unit: str
    low: float
    high: float
    usual_low: float
    usual_high: float


class EpisodeReport(msgspec.Struct, frozen=True):
    episode: int
    task: str
    frames: int
    seconds: float
    defects: str = msgspec.field(name="marks")
    speed: list[float]  # For each joint, in units per second.
    jerk: list[float]  # For each joint, in units per second cubed.
    curves: list[list[float]]  # For each joint: its commands, thinned out, from 0 to 1 of its range.
    pictures: dict[str, list[str]]  # For each camera: JPEG pictures, as base64.


class Report(msgspec.Struct, frozen=True):
    dataset: str
    robot_type: str
    fps: float
    cameras: list[str]
    tasks: dict[str, int]  # Number of episodes of each task.
    joints: list[Joint]
    episodes: list[EpisodeReport]
    findings: list[Finding]
    good: list[int]  # Episodes without a finding.

    @property
    def frames(self) -> int:
        return sum(episode.frames for episode in self.episodes)

    def findings_of(self, episode: int) -> list[Finding]:
        return [finding for finding in self.findings if finding.episode == episode]


def measure(root: Path) -> Report:
    """Read a whole dataset, and describe it.

    Raises:
        DatasetError: The folder is not a dataset of version 3, or it is not certain which episodes it has.
    """
    index, info = open_newest(root)
    index.require_certain()
    damaged = check(index).damaged
    sound = {number: row for number, row in sorted(index.rows.items()) if number not in damaged}
    images = [key for key, feature in info.features.items() if feature.dtype == "image"]
    tables = {row.number: _vectors(table, row) for row, table in episodes_of(root, sound.values(), images)}
    joints = _joints(info, {number: action for number, (action, _) in tables.items()})
    states = [state for _, state in tables.values()]
    spread = np.ptp(np.concatenate(states), axis=0) if states else np.zeros(0)
    motions = {number: motion_of(action, state, info.fps, spread) for number, (action, state) in tables.items()}
    cameras = [key for key, feature in info.features.items() if feature.dtype in ("video", "image")]
    seen: dict[str, dict[int, Pictures]] = {}
    shown: dict[int, dict[str, list[str]]] = defaultdict(dict)
    for key in cameras:
        seen[key] = {}
        for number, figures, few in _look(index, info, key, sound, motions):
            seen[key][number] = figures
            shown[number][_camera(key)] = few
    findings = [
        *(Finding(Kind.DAMAGED, number, text=reason) for number, reason in sorted(damaged.items())),
        *_notes(index, sound),
        *_of_motion(motions, joints, spread, info.fps),
        *find_outliers(Kind.LENGTH, {number: row.frames / info.fps for number, row in sound.items()}),
    ]
    still = max(2.0, STILL_S * info.fps)
    for key in cameras:
        findings += find_counts(Kind.STILL, {n: each.still for n, each in seen[key].items()}, _camera(key), still)
        brightness = {number: each.brightness for number, each in seen[key].items()}
        findings += find_outliers(Kind.BRIGHTNESS, brightness, least=4.0, name=_camera(key))
    episodes = [_episode(index, info, row, motions[number], joints, shown[number]) for number, row in sound.items()]
    unusual = {finding.episode for finding in findings}
    return Report(
        str(root),
        info.robot_type or "",
        info.fps,
        [_camera(key) for key in cameras],
        dict(Counter(episode.task for episode in episodes)),
        joints,
        episodes,
        findings,
        [number for number in sound if number not in unusual],
    )


def _vectors(table: pa.Table, row: EpisodeRow) -> tuple[Numbers, Numbers]:
    """Return the commands and the readings of an episode, with one row for each frame."""
    state = _matrix(table, STATE, row) if STATE in table.column_names else np.zeros((row.frames, 0))
    return _matrix(table, ACTION, row), state


def _matrix(table: pa.Table, name: str, row: EpisodeRow) -> Numbers:
    if name not in table.column_names:
        raise DatasetError(f"the dataset has no column {name}, so its motion cannot be described")
    values = table[name].combine_chunks()
    while is_list(values.type):
        values = values.flatten()
    return np.asarray(values.cast(pa.float64()).to_numpy(zero_copy_only=False)).reshape(row.frames, -1)


def _joints(info: Info, actions: Mapping[int, Numbers]) -> list[Joint]:
    feature = info.features.get(ACTION)
    if feature is None or not actions:
        return []
    width = next(iter(actions.values())).shape[1]
    names = feature.flat_names if len(feature.flat_names) == width else [f"{ACTION} {n}" for n in range(width)]
    units = feature.flat_units if len(feature.flat_units) == width else [""] * width
    low = np.array([action.min(0) for action in actions.values()])
    high = np.array([action.max(0) for action in actions.values()])
    return [
        Joint(
            name.removesuffix(".pos"),
            unit,
            float(low[:, joint].min()),
            float(high[:, joint].max()),
            float(np.quantile(low[:, joint], 0.1)),
            float(np.quantile(high[:, joint], 0.9)),
        )
        for joint, (name, unit) in enumerate(zip(names, units, strict=True))
    ]


def _notes(index: Index, rows: Mapping[int, EpisodeRow]) -> Iterator[Finding]:
    """Yield the notes of the recorder and of ``dataset label``."""
    for number in rows:
        if number in index.quality:
            quality = index.quality[number]
            yield from find_counts(Kind.GAPS, {number: quality.gaps})
            for name, count in quality.stale.items():
                yield from find_counts(Kind.LATE, {number: count}, name)
            if quality.mark:
                yield Finding(Kind.MARK, number, text=quality.mark)
    for key in index.info.videos if index.info else ():
        sums = {number: index.quality[number].pictures.get(key) for number in rows if number in index.quality}
        recorded = {number: checksum for number, checksum in sums.items() if checksum is not None}
        yield from find_equal(Kind.SAME_PICTURES, recorded, _camera(key))


def _of_motion(
    motions: Mapping[int, Motion], joints: list[Joint], spread: Numbers, fps: float
) -> Iterator[Finding]:
    names = [joint.name for joint in joints]
    ranges = [RANGE_SHARE * (joint.high - joint.low) for joint in joints]
    yield from find_equal(Kind.SAME_MOTION, {number: motion.fingerprint for number, motion in motions.items()})
    repeated = {number: motion.repeated for number, motion in motions.items()}
    yield from find_counts(Kind.REPEATED, repeated, least=max(2.0, STILL_S * fps))
    yield from find_by_joint(Kind.LOW, {n: motion.low for n, motion in motions.items()}, names, ranges)
    yield from find_by_joint(Kind.HIGH, {n: motion.high for n, motion in motions.items()}, names, ranges)
    no_least = [0.0] * len(names)
    yield from find_by_joint(Kind.SPEED, {n: motion.speed for n, motion in motions.items()}, names, no_least)
    yield from find_by_joint(Kind.JERK, {n: motion.jerk for n, motion in motions.items()}, names, no_least)
    begins = np.array([motion.begin for motion in motions.values()])
    if begins.size:
        # The distance from the usual first position, in shares of the joints' ranges.
        scale = np.where(spread > 0, spread, 1.0)
        distance = np.abs((begins - np.median(begins, axis=0)) / scale).max(1)
        by_episode = dict(zip(motions, distance.tolist(), strict=True))
        yield from find_outliers(Kind.BEGIN, by_episode, RANGE_SHARE)
    for joint in joints:
        if joint.high - joint.low <= UNUSED_SHARE * max(1.0, abs(joint.high)):
            yield Finding(Kind.UNUSED, -1, joint.name, joint.high)


def _look(
    index: Index, info: Info, key: str, rows: Mapping[int, EpisodeRow], motions: Mapping[int, Motion]
) -> Iterator[tuple[int, Pictures, list[str]]]:
    """Look at every picture of a camera. Yield the figures, and a few pictures, of each episode."""
    for row, pictures in _pictures(index, info, key, rows):
        figures = Pictures()
        chosen = set(np.linspace(0, row.frames - 1, SHOWN).round().astype(int).tolist())
        few = []
        for number, picture in enumerate(pictures):
            figures.add(picture, bool(motions[row.number].moving[number]))
            if number in chosen:
                few.append(base64.b64encode(encode_image(picture, WIDTH)).decode())
        yield row.number, figures, few


def _pictures(
    index: Index, info: Info, key: str, rows: Mapping[int, EpisodeRow]
) -> Iterator[tuple[EpisodeRow, Iterator[NDArray[np.uint8]]]]:
    """Yield each episode with its pictures, which must be taken before the next episode. Each video is decoded
    once."""
    if info.features[key].dtype == "image":
        for row, table in episodes_of(index.root, rows.values()):
            yield row, (decode_image(io.BytesIO(cell.as_py()["bytes"])) for cell in table[key])
        return
    by_file: dict[Path, list[EpisodeRow]] = defaultdict(list)
    for row in rows.values():
        by_file[row.videos[key].path].append(row)
    for path, its in by_file.items():
        pictures = pictures_of(index.root / path)
        position = 0
        for row in sorted(its, key=lambda row: row.videos[key].start_s):
            first = round(row.videos[key].start_s * info.fps)
            for _ in islice(pictures, first - position):
                pass
            position = first + row.frames
            yield row, islice(pictures, row.frames)


def _episode(
    index: Index, info: Info, row: EpisodeRow, motion: Motion, joints: list[Joint], pictures: dict[str, list[str]]
) -> EpisodeReport:
    low = np.array([joint.low for joint in joints])[:, None]
    width = np.array([(joint.high - joint.low) or 1.0 for joint in joints])[:, None]
    quality = index.quality.get(row.number)
    return EpisodeReport(
        row.number,
        ", ".join(row.tasks),
        row.frames,
        round(row.frames / info.fps, 3),
        quality.as_text if quality else "",
        _rounded(motion.speed),
        _rounded(motion.jerk),
        [_rounded(curve, 3) for curve in (motion.curves - low) / width],
        pictures,
    )


def _rounded(values: Any, digits: int = 6) -> list[float]:
    return [round(float(value), digits) for value in values]


def _camera(key: str) -> str:
    return key.removeprefix(CAMERA)
