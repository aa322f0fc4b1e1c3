"""A dataset on disk, open for writing: commit episodes, and clean up after a crash.

An episode is *committed* if the number of episodes in ``info.json`` includes it. A recorder writes an episode
into a folder below ``.staging``. When the episode is finished, ``commit`` makes it the next committed episode:

1. Write all its files complete into the staging folder, and sync them.
2. Write ``placing.json`` there, with the final names of these files.
3. Rename the videos, tasks and statistics to their final names. No index refers to the videos yet.
4. Rename data, index and, last, ``info.json``. This last rename is the commit.

LeRobot reads every file that it finds, even files that belong to no committed episode ("stray files"). A
crash between two steps leaves such files. Therefore each program that opens the dataset for writing first
removes stray files, or moves them into ``.staging``. Then it commits the finished episodes in
``.staging`` again.

Invariant: a committed episode is never moved or removed. If it is not certain which episodes are committed,
no file is changed.
"""

from __future__ import annotations

import contextlib
import itertools
import json
from collections.abc import Callable
from pathlib import Path
from typing import IO

import msgspec

from .check import NO_STATISTICS, check
from .episode import Episode, columns_of, data_table, index_row, index_table, quality_of, statistics_of
from .errors import DatasetError
from .index import Index
from .info import VERSION, decode_info
from .layout import (
    INFO,
    STAGING,
    STATS,
    TASKS,
    FileSlot,
    Layout,
    contradiction_of,
    difference_of,
    is_own_name,
    layout_of,
    tasks_table,
)
from .staging import FINISHED, Staged, read_staged, staged_folders
from .statistics import aggregate
from .storage import REMOVED, STAGED_SUFFIX, Lock, Storage
from .tables import parquet
from .video import DEFAULT, count_frames, remux

PLACING = "placing.json"
"""File in an episode's staging folder: its number and the final names of its files. It is written before the
first of them is renamed."""
STRAYS = "uncounted"
"""Folder below ``.staging`` to which stray files are moved."""


class Dataset:
    """A dataset that is open for writing. Only one process at a time can open it."""

    def __init__(self, root: Path, storage: Storage | None = None, accept_damage: bool = False) -> None:
        """Open the dataset, move stray files (of no committed episode) away, and commit the finished episodes,
        which are still in the staging folder.

        Args:
            root: The dataset's folder. It is created if it does not exist.
            storage: The disk; a test may replace it.
            accept_damage: Open the dataset even if data or videos are damaged. ``checked`` then lists the
                damage, and every picture is read for this. If it is not certain which episodes are committed,
                the dataset is refused nevertheless.

        Raises:
            DatasetError: The dataset is damaged or not of this format, or another process writes into it.
            OSError: The disk cannot be read or written.
        """
        self.root = root
        self.storage = storage or Storage()
        self._made = [folder for folder in (root, *root.parents) if not folder.exists()]
        # Only the user may read the dataset, because its pictures show the user's surroundings.
        root.mkdir(0o700, parents=True, exist_ok=True)
        self._lock = Lock(root)
        self.moved_strays: list[str] = []
        self.recovered: list[Episode] = []
        try:
            index = Index(root)
            if index.info and index.info.is_older:
                raise DatasetError(
                    f"{root} has version {index.info.codebase_version}, and only {VERSION} can be written. "
                    "Make a converted copy with `strands-actors dataset convert`"
                )
            index.require_certain()
            self.checked = check(index, read_pictures=accept_damage)
            if not accept_damage:
                self.checked.require_sound(root)
            self._take(index)
            self._clear_strays(index)
            self._last = index.last_slot()
            self._recover()
        except BaseException:
            self.close()
            raise

    def _take(self, index: Index) -> None:
        self._layout: Layout | None = None
        self.episodes = index.episodes
        self._frames = index.frames
        self._tasks = index.tasks
        self._statistics = aggregate([row.statistics for _, row in sorted(index.rows.items())])
        self._info = index.info

    @property
    def layout(self) -> Layout | None:
        """The layout (rate and features) of the dataset's episodes, or None if there are no episodes yet.

        Raises:
            DatasetError: The dataset has a layout that a recording here cannot have.
        """
        if self._layout is None and self._info is not None and self.episodes:
            try:
                self._layout = layout_of(self._info)
            except DatasetError as error:
                raise DatasetError(f"{self.root} cannot take recordings: {error}. Use another folder") from error
        return self._layout

    @property
    def staging(self) -> Path:
        return self.root / STAGING

    def unfinished(self) -> list[Path]:
        """Return the folders of episodes that are unfinished, or could not be committed."""
        return list(staged_folders(self.staging))

    def require(self, layout: Layout) -> Layout:
        """Return the layout (rate and features) for a new recording.

        Args:
            layout: The layout of the new episode.

        Returns:
            The dataset's layout. If the dataset states no units, the units come from ``layout``. If the dataset
            has no episode yet, ``layout``.

        Raises:
            DatasetError: The dataset has another layout.
        """
        ours = self.layout
        if ours is None:
            self._require_declared(layout)
            return layout
        for field in ("robot_type", "fps"):
            if (expected := getattr(ours, field)) != (requested := getattr(layout, field)):
                raise DatasetError(
                    f"{self.root} has {field} {expected}, but this recording has {requested}. Use another folder"
                )
        if difference := difference_of(layout.typed_features(), ours.typed_features()):
            raise DatasetError(f"{self.root} has other features: {difference}. Use another folder")
        return ours if ours.units else msgspec.structs.replace(ours, units=layout.units)

    def _require_declared(self, layout: Layout) -> None:
        """Check that a recording fits ``info.json`` of a dataset without episodes, which another program has
        created.

        Raises:
            DatasetError: ``info.json`` declares a rate or a feature that the recording does not have.
        """
        if self._info is None:
            return
        if self._info.fps != layout.fps:
            reason = f"it declares {self._info.fps:g} fps, but this recording has {layout.fps}"
        elif difference := contradiction_of(layout.typed_features(), self._info.features):
            reason = f"its {INFO} declares other features: {difference}"
        else:
            return
        raise DatasetError(
            f"{self.root} has no episode yet, and {reason}. "
            "Record with the declared features, or use another folder"
        )

    def codec_for(self, named: str | None) -> str:
        """Return the codec for new videos.

        Args:
            named: The requested codec. None means the codec of the dataset's videos, or the default if it has
                no videos.

        Raises:
            DatasetError: The dataset's videos have another codec than the requested one.
        """
        ours = self.layout.codec if self.layout and self.layout.cameras else None
        if named and ours and named != ours:
            raise DatasetError(
                f"{self.root} has videos with the codec {ours}, "
                f"not {named}. Leave the codec out, or use another folder"
            )
        return named or ours or DEFAULT

    def require_place(self) -> None:
        """Raise ``DatasetError`` if the opened folder was moved, or its disk unmounted."""
        if not self._lock.is_of(self.root):
            raise DatasetError(
                f"{self.root} was moved, or its disk was unmounted. "
                "Put it back. Saved episodes are safe, and an unfinished episode is in the folder .staging"
            )

    def free_bytes(self) -> int:
        """Return the free bytes on the disk.

        Raises:
            DatasetError: The opened folder was moved, or its disk unmounted.
            OSError: The disk does not answer.
        """
        self.require_place()
        return self.storage.free_bytes(self.root)

    def close(self) -> None:
        """Release the lock. Remove the staging folder if it is empty, and the empty folders that the
        constructor created."""
        with contextlib.suppress(OSError):  # The folder may be missing, or not empty.
            self.staging.rmdir()
        with contextlib.suppress(OSError):
            for folder in self._made if self._lock.is_of(self.root) else ():
                folder.rmdir()
        self._lock.release()

    # -- stray files

    def _recover(self) -> None:
        """Commit the finished episodes in the staging folder (make them part of the dataset). An episode that
        cannot be committed stays in this folder, and ``repair`` reports the reason."""
        for folder in staged_folders(self.staging):
            if (folder / FINISHED).exists():
                with contextlib.suppress(DatasetError):
                    self.recovered.append(self.commit(folder))

    def _clear_strays(self, index: Index) -> None:
        """Remove the stray files, or move them away.

        Files of an interrupted commit are removed, because the staging folder still has the whole episode.
        Other stray files that are named like files of a recording are moved into ``.staging``. Files with
        other names stay.
        """
        ours: set[Path] = set()
        done: list[Path] = []
        for folder in staged_folders(self.staging):
            placing = folder / PLACING
            if placing.exists():
                number, *names = json.loads(placing.read_bytes())
                # The episode was committed, but a crash kept its staging folder from being removed.
                if number < len(self.episodes):
                    done.append(folder)
                else:
                    ours |= {self.root / name for name in names}
        strays = [path.relative_to(self.root) for path in index.stray_files()]
        if not self.episodes:
            self._require_empty([path for path in strays if self.root / path not in ours])
        for folder in [*self.staging.glob(REMOVED + "*"), *done]:
            self.storage.remove(folder)
        has_changed = bool(ours)
        for path in filter(is_own_name, strays):  # Files with other names are the user's, so they stay.
            if self.root / path in ours or path.name.endswith(STAGED_SUFFIX):
                self.storage.remove(self.root / path)
            elif self.checked.damaged:
                continue  # The file may have the frames that a damaged episode lacks, so it stays.
            else:
                self.storage.place(self.root / path, _free(self.staging / STRAYS / path))
                self.moved_strays.append(str(path))
            has_changed = True
        has_statistics = index.has_statistics() or not self._statistics
        if (has_changed or not has_statistics) and self._info is not None:
            self._write(self.root / TASKS, parquet(tasks_table(self._tasks)))
            self._write(self.root / STATS, _json(self._statistics))
            self.checked.faults = [fault for fault in self.checked.faults if fault != NO_STATISTICS]

    def _require_empty(self, strange: list[Path]) -> None:
        """Raise ``DatasetError`` if a dataset without episodes has data files or videos. A recorder cannot
        have left them: they may be the user's only copy, so they must not be moved."""
        if strange:
            counts = f"no {INFO}" if self._info is None else f"no episode in its {INFO}"
            raise DatasetError(
                f"{self.root} has {counts}, but files that look like a dataset's: {strange[0]} "
                f"({len(strange)} files). Give a new folder, or put the dataset's {INFO} back"
            )

    # -- the commit

    def commit(self, folder: Path) -> Episode:
        """Move an episode from its staging folder into the dataset, as the next committed episode. See the
        module's docstring for the steps.

        Args:
            folder: The episode's staging folder. It is removed at the end.

        Raises:
            DatasetError: No frame of the episode can be used, or the episode does not fit the dataset. The
                episode stays in staging.
        """
        self.require_place()
        staged = read_staged(folder)
        layout = self.require(staged.about.layout)
        frames = self._usable(staged)
        if not frames:
            raise DatasetError(
                f"{folder} has no complete frame. Remove it with `strands-actors dataset repair {self.root} --drop`"
            )
        table = staged.table.slice(0, frames).combine_chunks()
        number, slot = len(self.episodes), self._last.next if self._last else FileSlot(0, 0)
        task = staged.about.task
        tasks = self._tasks if task in self._tasks else [*self._tasks, task]
        columns = columns_of(layout, table, number, self._frames, tasks.index(task))
        videos = {camera.name: staged.folder / f"{camera.name}.final.mp4" for camera in layout.cameras}
        pictures = {camera.key: self._video(staged, camera.name, frames) for camera in layout.cameras}
        statistics = statistics_of(staged, columns, layout, videos)
        quality = quality_of(staged, table, pictures)
        row = index_row(number, task, self._frames, frames, slot, layout, statistics)
        total = aggregate([self._statistics, statistics]) if self._statistics else statistics
        info = layout.info(number + 1, self._frames + frames, len(tasks))

        first = {slot.video(camera.key): videos[camera.name] for camera in layout.cameras} | {
            TASKS: self._stage(folder, "tasks.parquet", parquet(tasks_table(tasks))),
            STATS: self._stage(folder, "stats.json", _json(total)),
        }
        committed = {
            slot.data: self._stage(folder, "data.parquet", parquet(data_table(columns))),
            slot.episodes: self._stage(folder, "index.parquet", parquet(index_table([row], {number: quality}))),
        }
        last = {INFO: self._stage(folder, "info.json", _json(info))}
        paths = [str(path) for path in (*first, *committed)]
        self.storage.write(folder / PLACING, json.dumps([number, *paths]).encode())
        # First rename the files that no index refers to. Then rename data, index and info.json, one directly
        # after the other, because between these renames LeRobot could read frames that are not committed yet.
        # The file system keeps the order of the renames.
        for files in (first, committed | last):
            self._place(files)

        self._info, self._layout = decode_info(_encoded(info), INFO), layout
        self._frames += frames
        self._tasks, self._statistics, self._last = tasks, total, slot
        self.episodes.append(Episode(number, task, frames, quality))
        self.storage.remove(folder)
        return self.episodes[-1]

    def _video(self, staged: Staged, camera: str, frames: int) -> int:
        path = staged.folder / f"{camera}.final.mp4"
        checksum = remux(staged.video(camera), path, staged.about.layout.fps, frames)
        self.storage.sync_path(path)
        return checksum

    def _usable(self, staged: Staged) -> int:
        layout = staged.about.layout
        counts = [count_frames(staged.video(camera.name)) for camera in layout.cameras]
        return min([int(staged.table.num_rows), *counts])

    def _stage(self, folder: Path, name: str, fill: Callable[[IO[bytes]], object]) -> Path:
        path = folder / name
        with self.storage.create(path) as file:
            fill(file)
            self.storage.sync(file)
        return path

    def _write(self, path: Path, fill: Callable[[IO[bytes]], object]) -> None:
        staged = self._stage(path.parent, path.name + STAGED_SUFFIX, fill)
        self.storage.place(staged, path)

    def _place(self, files: dict[Path, Path]) -> None:
        """Rename complete files to their final names, and wait until the names are on the disk."""
        for name in files:
            (self.root / name).parent.mkdir(parents=True, exist_ok=True)
        for name, staged in files.items():
            self.storage.place(staged, self.root / name)
        for folder in {(self.root / name).parent for name in files}:
            self.storage.sync_path(folder)


def _free(path: Path) -> Path:
    """Return a path at which no file exists: the given path, or the same path with a number added to the
    name."""
    names = itertools.chain([path.name], (f"{path.stem}-{number}{path.suffix}" for number in itertools.count(2)))
    return next(each for name in names if not (each := path.with_name(name)).exists())


def _json(value: object) -> Callable[[IO[bytes]], object]:
    return lambda file: file.write(_encoded(value))


def _encoded(value: object) -> bytes:
    return json.dumps(value, indent=4).encode()
