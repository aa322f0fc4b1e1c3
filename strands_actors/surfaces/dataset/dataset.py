"""A dataset on disk, open for writing: commit episodes, and clean up after a crash.

An episode is *counted* if the number of episodes in ``info.json`` includes it. A recorder writes an episode
into a folder below ``.staging``. When the episode is finished, ``commit`` makes it the next counted one:

1. Write all its files complete into the staging folder, and sync them.
2. Write ``placing.json`` there, with the final names of these files.
3. Rename the videos, tasks and statistics to their final names. No index refers to the videos yet.
4. Rename data, index and, last, ``info.json``. This last rename is the commit.

LeRobot reads every file that it finds, counted or not. So a crash between two steps would leave it frames
that are not counted. Therefore each program that opens the dataset for writing first removes or puts aside
the files that are not counted, and then commits the finished episodes in ``.staging`` again.

Invariant: a counted episode is never moved or removed. If it is not certain which episodes are counted,
nothing is touched.
"""

from __future__ import annotations

import contextlib
import itertools
import json
from collections.abc import Callable
from pathlib import Path
from typing import IO

import msgspec

from .check import NO_FIGURES, check
from .episode import Episode, columns_of, data_table, figures_of, index_row, index_table, marks_of
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
ASIDE = "uncounted"
"""Folder below ``.staging`` for files that are put aside."""


class Dataset:
    """A dataset that is open for writing. Only one process at a time can open it."""

    def __init__(self, root: Path, storage: Storage | None = None, accept_damage: bool = False) -> None:
        """Open the dataset, put uncounted files aside, and commit the finished episodes in staging.

        Args:
            root: The dataset's folder. It is created if it does not exist.
            storage: The disk; a test may replace it.
            accept_damage: Read every picture, and open a dataset with damaged data or videos, too.
                ``checked`` lists the damage. A dataset is refused in any case if it is not certain
                which episodes are counted.

        Raises:
            DatasetError: It is damaged, of another kind, or another process writes into it.
            OSError: The disk cannot be read or written.
        """
        self.root = root
        self.storage = storage or Storage()
        self._made = [folder for folder in (root, *root.parents) if not folder.exists()]
        root.mkdir(0o700, parents=True, exist_ok=True)  # private, as a recording: the pictures show the place
        self._lock = Lock(root)
        self.swept: list[str] = []
        self.recovered: list[Episode] = []
        try:
            index = Index(root)
            if index.info and index.info.is_older:
                raise DatasetError(
                    f"{root} has version {index.info.codebase_version}, this writes {VERSION}. "
                    "`strands-actors dataset convert` makes a copy of that version"
                )
            index.require_certain()
            self.checked = check(index, read_pictures=accept_damage)
            if not accept_damage:
                self.checked.require_sound(root)
            self._take(index)
            self._sweep(index)
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
        self._figures = aggregate([row.figures for _, row in sorted(index.rows.items())])
        self._info = index.info

    @property
    def layout(self) -> Layout | None:
        """The layout of its episodes; None if there are no episodes yet.

        Raises:
            DatasetError: A recording cannot have such a layout.
        """
        if self._layout is None and self._info is not None and self.episodes:
            try:
                self._layout = layout_of(self._info)
            except DatasetError as other:
                raise DatasetError(f"{self.root} cannot be recorded into: {other}") from other
        return self._layout

    @property
    def staging(self) -> Path:
        return self.root / STAGING

    def unfinished(self) -> list[Path]:
        """Return the folders of episodes that are unfinished, or could not be committed."""
        return list(staged_folders(self.staging))

    def require(self, layout: Layout) -> Layout:
        """Return the layout to record with.

        Args:
            layout: The layout of the new episode.

        Returns:
            The dataset's layout. If it states no units, they are taken from ``layout``. For the first
            episode, ``layout`` itself.

        Raises:
            DatasetError: The dataset has another layout.
        """
        ours = self.layout
        if ours is None:
            self._require_declared(layout)
            return layout
        for field in ("robot_type", "fps"):
            if (there := getattr(ours, field)) != (here := getattr(layout, field)):
                raise DatasetError(f"{self.root} has {field} {there}, this would be {here}. use another folder")
        if difference := difference_of(layout.typed_features(), ours.typed_features()):
            raise DatasetError(f"{self.root} has other features: {difference}. use another folder")
        return ours if ours.units else msgspec.structs.replace(ours, units=layout.units)

    def _require_declared(self, layout: Layout) -> None:
        """Check a dataset that another program has created and that has no episode yet.

        Raises:
            DatasetError: Its ``info.json`` declares something that this recording would not have.
        """
        if self._info is None:
            return
        if self._info.fps != layout.fps:
            why = f"it declares {self._info.fps:g} fps, this would be {layout.fps}"
        elif other := contradiction_of(layout.typed_features(), self._info.features):
            why = f"of what it declares {other}"
        else:
            return
        raise DatasetError(
            f"{self.root} has no episode yet, and {why}. Record what it declares, or use another folder"
        )

    def codec_for(self, named: str | None) -> str:
        """Return the codec for new videos.

        Args:
            named: The requested codec; None for that of the dataset, or else the default.

        Raises:
            DatasetError: The dataset's videos have another codec than the requested one.
        """
        ours = self.layout.codec if self.layout and self.layout.cameras else None
        if named and ours and named != ours:
            raise DatasetError(
                f"{self.root} has videos of {ours}, not {named}. name no codec, or use another folder"
            )
        return named or ours or DEFAULT

    def require_place(self) -> None:
        """Raise ``DatasetError`` if the folder is no longer the one that was opened."""
        if not self._lock.is_of(self.root):
            raise DatasetError(
                f"{self.root} is not the folder any more that was opened: it was moved, or its disk taken away. "
                "put it back; what was counted is there, and an episode that ran is in its .staging"
            )

    def free_bytes(self) -> int:
        """Return the free bytes on the disk.

        Raises:
            DatasetError: The folder is no longer the one that was opened.
            OSError: The disk does not answer.
        """
        self.require_place()
        return self.storage.free_bytes(self.root)

    def close(self) -> None:
        """Release the lock. Remove the staging folder if it is empty, and the empty folders that the
        constructor created."""
        with contextlib.suppress(OSError):  # missing, or not empty
            self.staging.rmdir()
        with contextlib.suppress(OSError):
            for folder in self._made if self._lock.is_of(self.root) else ():
                folder.rmdir()
        self._lock.release()

    # -- files that are not counted

    def _recover(self) -> None:
        """Commit the finished episodes in staging. One that cannot be committed stays, and ``repair``
        reports why."""
        for folder in staged_folders(self.staging):
            if (folder / FINISHED).exists():
                with contextlib.suppress(DatasetError):
                    self.recovered.append(self.commit(folder))

    def _sweep(self, index: Index) -> None:
        """Remove or put aside the files that are not counted.

        Files of an interrupted commit are removed, because staging still has the whole episode. Other
        uncounted files with a dataset's names are put aside. Files with other names stay.
        """
        ours: set[Path] = set()
        done: list[Path] = []
        for folder in staged_folders(self.staging):
            placing = folder / PLACING
            if placing.exists():
                number, *names = json.loads(placing.read_bytes())
                if number < len(self.episodes):  # committed, but its staging folder was not removed
                    done.append(folder)
                else:
                    ours |= {self.root / name for name in names}
        uncounted = [path.relative_to(self.root) for path in index.uncounted()]
        if not self.episodes:
            self._require_empty([path for path in uncounted if self.root / path not in ours])
        for folder in [*self.staging.glob(REMOVED + "*"), *done]:
            self.storage.remove(folder)
        swept = bool(ours)
        for path in filter(is_own_name, uncounted):  # files with other names belong to the user and stay
            if self.root / path in ours or path.name.endswith(STAGED_SUFFIX):
                self.storage.remove(self.root / path)
            elif self.checked.damaged:
                continue  # it may have the frames that a damaged episode lacks
            else:
                self.storage.place(self.root / path, _free(self.staging / ASIDE / path))
                self.swept.append(str(path))
            swept = True
        has_figures = index.has_figures() or not self._figures
        if (swept or not has_figures) and self._info is not None:
            self._write(self.root / TASKS, parquet(tasks_table(self._tasks)))
            self._write(self.root / STATS, _json(self._figures))
            self.checked.faults = [fault for fault in self.checked.faults if fault != NO_FIGURES]

    def _require_empty(self, strange: list[Path]) -> None:
        """Raise ``DatasetError`` if a dataset without episodes has files with a dataset's names. A recorder
        cannot have left them, so they are not put aside."""
        if strange:
            counts = f"no {INFO}" if self._info is None else f"no episode in its {INFO}"
            raise DatasetError(
                f"{self.root} has {counts}, and files that would be taken for a dataset's: {strange[0]} "
                f"({len(strange)} files). give a new folder; if this was a dataset, put its {INFO} back"
            )

    # -- the commit

    def commit(self, folder: Path) -> Episode:
        """Make a staged episode the next counted one. See the module's docstring for the steps.

        Args:
            folder: The episode's staging folder. It is removed at the end.

        Raises:
            DatasetError: No frame of it can be used, or it does not fit the dataset. It stays in staging.
        """
        self.require_place()
        staged = read_staged(folder)
        layout = self.require(staged.about.layout)
        frames = self._usable(staged)
        if not frames:
            raise DatasetError(
                f"{folder} has no complete frame. `strands-actors dataset repair {self.root} --drop` removes it"
            )
        table = staged.table.slice(0, frames).combine_chunks()
        number, slot = len(self.episodes), self._last.next if self._last else FileSlot(0, 0)
        task = staged.about.task
        tasks = self._tasks if task in self._tasks else [*self._tasks, task]
        columns = columns_of(layout, table, number, self._frames, tasks.index(task))
        videos = {camera.name: staged.folder / f"{camera.name}.final.mp4" for camera in layout.cameras}
        pictures = {camera.key: self._video(staged, camera.name, frames) for camera in layout.cameras}
        figures = figures_of(staged, columns, layout, videos)
        marks = marks_of(staged, table, pictures)
        row = index_row(number, task, self._frames, frames, slot, layout, figures)
        total = aggregate([self._figures, figures]) if self._figures else figures
        info = layout.info(number + 1, self._frames + frames, len(tasks))

        first = {slot.video(camera.key): videos[camera.name] for camera in layout.cameras} | {
            TASKS: self._stage(folder, "tasks.parquet", parquet(tasks_table(tasks))),
            STATS: self._stage(folder, "stats.json", _json(total)),
        }
        counted = {
            slot.data: self._stage(folder, "data.parquet", parquet(data_table(columns))),
            slot.episodes: self._stage(folder, "index.parquet", parquet(index_table([row], {number: marks}))),
        }
        last = {INFO: self._stage(folder, "info.json", _json(info))}
        where = [str(path) for path in (*first, *counted)]
        self.storage.write(folder / PLACING, json.dumps([number, *where]).encode())
        # First rename the files that no index refers to. Then rename data, index and info.json, and do nothing
        # else in between, because LeRobot would read frames that are not counted yet. The file system keeps
        # the order of the renames.
        for files in (first, counted | last):
            self._place(files)

        self._info, self._layout = decode_info(_encoded(info), INFO), layout
        self._frames += frames
        self._tasks, self._figures, self._last = tasks, total, slot
        self.episodes.append(Episode(number, task, frames, marks))
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
    """Return the path, or if it exists, one with a number in its name. Files that were put aside before are
    kept."""
    names = itertools.chain([path.name], (f"{path.stem}-{number}{path.suffix}" for number in itertools.count(2)))
    return next(each for name in names if not (each := path.with_name(name)).exists())


def _json(value: object) -> Callable[[IO[bytes]], object]:
    return lambda file: file.write(_encoded(value))


def _encoded(value: object) -> bytes:
    return json.dumps(value, indent=4).encode()
