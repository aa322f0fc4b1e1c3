"""A dataset on disk: what is counted, and how an episode comes to be counted.

``info.json`` says how many episodes there are, and is renamed last: that is the commit. Whoever
opens the dataset to write puts aside what ``info.json`` does not count, since LeRobot reads every
file it finds.
"""

from __future__ import annotations

import contextlib
import itertools
import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import IO, Any

import msgspec
import pyarrow as pa
import pyarrow.parquet as pq

from .episode import (
    Marks,
    columns_of,
    data_table,
    figures_in,
    figures_of,
    index_row,
    index_table,
    marks_in,
    marks_of,
)
from .errors import DatasetError
from .layout import (
    INFO,
    STAGING,
    STATS,
    TASKS,
    FileSlot,
    Layout,
    difference_of,
    is_own_name,
    layout_of,
    read_info,
    tasks_of,
    tasks_table,
)
from .staging import FINISHED, Staged, read_staged, staged_folders
from .statistics import aggregate
from .storage import REMOVED, STAGED_SUFFIX, Lock, Storage
from .video import DEFAULT, count_frames, remux

PLACING = "placing.json"
"""In an episode's folder: where its files go, written before the first of them goes there."""
ASIDE = "uncounted"


class Episode(msgspec.Struct, frozen=True):
    """One that is counted."""

    index: int
    task: str
    frames: int
    marks: Marks


class Index:
    """What ``info.json`` counts, as it lies on the disk."""

    def __init__(self, root: Path) -> None:
        """Read it. Raise ``DatasetError`` when files are missing or do not fit."""
        self.root = root
        self.info = read_info(root)
        self.rows: list[dict[str, Any]] = []
        self.marks: dict[int, Marks] = {}
        self.files: set[Path] = set()
        total = self.info["total_episodes"] if self.info else 0
        for path in sorted((root / "meta/episodes").glob("*/*.parquet")):
            table = _read(path)
            numbers = table["episode_index"].to_pylist()
            if counted := [number for number in numbers if number < total]:
                if len(counted) < len(numbers):
                    raise DatasetError(f"{path} counts more episodes than {INFO}: its writer did not finish")
                self.rows += table.to_pylist()
                self.marks |= marks_in(table)
                self.files.add(path)
        self.rows.sort(key=lambda row: int(row["episode_index"]))
        if [row["episode_index"] for row in self.rows] != list(range(total)):
            raise DatasetError(f"{root}: {INFO} counts {total} episodes, the index has {len(self.rows)} of them")
        self.tasks: list[str] = []
        if self.info:
            has_tasks = total or (root / TASKS).exists()  # one that was just created has none
            self.tasks = tasks_of(_read(root / TASKS))[: self.info.get("total_tasks")] if has_tasks else []
            self.files |= {root / path for row in self.rows for path in files_of(row, self.videos)}
            if missing := sorted(str(path) for path in self.files if not path.exists()):
                raise DatasetError(f"{missing[0]} is missing ({len(missing)} files)")

    @property
    def videos(self) -> list[str]:
        features = self.info["features"] if self.info else {}
        return [key for key, feature in features.items() if feature["dtype"] == "video"]

    @property
    def frames(self) -> int:
        return sum(row["length"] for row in self.rows)

    @property
    def episodes(self) -> list[Episode]:
        return [
            Episode(number, ", ".join(row["tasks"]), row["length"], self.marks.get(number, Marks()))
            for number, row in enumerate(self.rows)
        ]

    def uncounted(self) -> list[Path]:
        """Return the files that LeRobot would find, or might, and that are not counted."""
        found = [
            path for path in self.root.glob("meta/*" + STAGED_SUFFIX) if is_own_name(path.relative_to(self.root))
        ]
        for pattern in ("data/*/*.parquet", "meta/episodes/*/*.parquet", "videos/*/*/*.mp4"):
            found += [path for path in self.root.glob(pattern) if path not in self.files]
        return sorted(found)

    def last_slot(self) -> FileSlot | None:
        slots = [FileSlot(int(path.parent.name[6:]), int(path.stem[5:])) for path in self.files]
        return max(slots, default=None)


def files_of(row: dict[str, Any], videos: list[str]) -> Iterator[Path]:
    """The data and the videos of an episode."""
    yield FileSlot(row["data/chunk_index"], row["data/file_index"]).data
    for key in videos:
        yield FileSlot(row[f"videos/{key}/chunk_index"], row[f"videos/{key}/file_index"]).video(key)


def _read(path: Path) -> pa.Table:
    try:
        return pq.read_table(path)
    except (pa.ArrowException, OSError) as damage:
        raise DatasetError(f"{path} cannot be read: {' '.join(str(damage).split())}") from damage


class Dataset:
    """Open to write, by one process at a time."""

    def __init__(self, root: Path, storage: Storage | None = None) -> None:
        """Put aside what is not counted, and commit what was finished. Raise ``DatasetError``,
        ``OSError``."""
        self.root = root
        self.storage = storage or Storage()
        self._made = [folder for folder in (root, *root.parents) if not folder.exists()]
        root.mkdir(parents=True, exist_ok=True)
        self._lock = Lock(root)
        self.swept: list[str] = []
        self.recovered: list[Episode] = []
        try:
            index = Index(root)
            self._take(index)
            self._sweep(index)
            self._recover()
        except BaseException:
            self.close()
            raise

    def _take(self, index: Index) -> None:
        self.layout = layout_of(index.info) if index.info else None
        self.episodes = index.episodes
        self._frames = index.frames
        self._tasks = index.tasks
        self._figures = aggregate([figures_in(row) for row in index.rows])
        self._last = index.last_slot()
        self._info = index.info

    @property
    def staging(self) -> Path:
        return self.root / STAGING

    def unfinished(self) -> list[Path]:
        """Return the folders of episodes that nobody has finished, or that could not be counted."""
        return list(staged_folders(self.staging))

    def require(self, layout: Layout) -> Layout:
        """Return the layout to record with. Raise ``DatasetError`` when the dataset has another
        one."""
        ours = self.layout
        if ours is None:
            return layout
        for what in ("robot_type", "fps"):
            if (there := getattr(ours, what)) != (here := getattr(layout, what)):
                raise DatasetError(f"{self.root} has {what} {there}, this would be {here}. use another folder")
        if difference := difference_of(layout.features(), ours.features()):
            raise DatasetError(f"{self.root} has other features: {difference}. use another folder")
        return ours if ours.units else msgspec.structs.replace(ours, units=layout.units)

    def codec_for(self, named: str | None) -> str:
        """Return what to encode videos with. Raise ``DatasetError`` when another codec was named than
        the dataset has."""
        ours = self.layout.codec if self.layout and self.layout.cameras else None
        if named and ours and named != ours:
            raise DatasetError(
                f"{self.root} has videos of {ours}, not {named}. name no codec, or use another folder"
            )
        return named or ours or DEFAULT

    def require_place(self) -> None:
        """Raise ``DatasetError`` when the folder is another than the one that was opened."""
        if not self._lock.is_of(self.root):
            raise DatasetError(
                f"{self.root} is not the folder any more that was opened: it was moved, or its disk taken away. "
                "put it back; what was counted is there, and an episode that ran is in its .staging"
            )

    def free_bytes(self) -> int:
        """Return what the disk has left. Raise ``DatasetError``, ``OSError``."""
        self.require_place()
        return self.storage.free_bytes(self.root)

    def close(self) -> None:
        """Let others write. What is empty goes: of folders, those that were made for this."""
        with contextlib.suppress(OSError):  # it is not there, or not empty
            self.staging.rmdir()
        with contextlib.suppress(OSError):
            for folder in self._made if self._lock.is_of(self.root) else ():
                folder.rmdir()
        self._lock.release()

    # -- what is not counted

    def _recover(self) -> None:
        """Commit what was finished. What cannot be, stays for ``repair``, which says why."""
        for folder in staged_folders(self.staging):
            if (folder / FINISHED).exists():
                with contextlib.suppress(DatasetError):
                    self.recovered.append(self.commit(folder))

    def _sweep(self, index: Index) -> None:
        ours: set[Path] = set()
        done: list[Path] = []
        for folder in staged_folders(self.staging):
            placing = folder / PLACING
            if placing.exists():
                number, *names = json.loads(placing.read_bytes())
                if number < len(self.episodes):  # it was counted; only its folder was left
                    done.append(folder)
                else:
                    ours |= {self.root / name for name in names}
        uncounted = [path.relative_to(self.root) for path in index.uncounted()]
        if self._info is None:
            self._require_empty([path for path in uncounted if self.root / path not in ours])
        for folder in [*self.staging.glob(REMOVED + "*"), *done]:
            self.storage.remove(folder)
        for path in filter(is_own_name, uncounted):  # what is called otherwise is somebody's: it stays
            if self.root / path in ours or path.name.endswith(STAGED_SUFFIX):
                self.storage.remove(self.root / path)
            else:
                self.storage.place(self.root / path, _free(self.staging / ASIDE / path))
                self.swept.append(str(path))
        if (uncounted or ours) and self._info is not None:
            self._write(self.root / TASKS, _parquet(tasks_table(self._tasks)))
            self._write(self.root / STATS, lambda file: file.write(json.dumps(self._figures, indent=4).encode()))

    def _require_empty(self, strange: list[Path]) -> None:
        """Before the first episode there is nothing of ours to put aside."""
        if strange:
            raise DatasetError(
                f"{self.root} has no {INFO}, and files that would be taken for a dataset's: {strange[0]} "
                f"({len(strange)} files). give a new folder; if this was a dataset, put its {INFO} back"
            )

    # -- the commit

    def commit(self, folder: Path) -> Episode:
        """Make a staged episode the next one. Raise ``DatasetError`` when nothing of it can be
        used; it stays where it is."""
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
        videos = {camera.name: self._video(staged, camera.name, frames) for camera in layout.cameras}
        figures = figures_of(staged, columns, layout, videos)
        marks = marks_of(staged, table)
        row = index_row(number, task, self._frames, frames, slot, layout, figures)
        total = aggregate([self._figures, figures]) if self._figures else figures
        info = layout.info(number + 1, self._frames + frames, len(tasks))

        first = {slot.video(camera.key): videos[camera.name] for camera in layout.cameras} | {
            TASKS: self._stage(folder, "tasks.parquet", _parquet(tasks_table(tasks))),
            STATS: self._stage(folder, "stats.json", _json(total)),
        }
        counted = {
            slot.data: self._stage(folder, "data.parquet", _parquet(data_table(columns))),
            slot.episodes: self._stage(folder, "index.parquet", _parquet(index_table([row], {number: marks}))),
        }
        last = {INFO: self._stage(folder, "info.json", _json(info))}
        where = [str(path) for path in (*first, *counted)]
        self.storage.write(folder / PLACING, json.dumps([number, *where]).encode())
        # Nothing points at the videos yet. Between data and info.json there are three renames and nothing
        # else: LeRobot would read what is not counted. The system keeps them in their order.
        for files in (first, counted | last):
            self._place(files)

        self._info, self.layout = info, layout
        self._frames += frames
        self._tasks, self._figures, self._last = tasks, total, slot
        self.episodes.append(Episode(number, task, frames, marks))
        self.storage.remove(folder)
        return self.episodes[-1]

    def _video(self, staged: Staged, camera: str, frames: int) -> Path:
        path = staged.folder / f"{camera}.final.mp4"
        remux(staged.video(camera), path, staged.about.layout.fps, frames)
        self.storage.sync_path(path)
        return path

    def _usable(self, staged: Staged) -> int:
        layout = staged.about.layout
        counts = [count_frames(staged.video(camera.name), layout.fps) for camera in layout.cameras]
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
        """Give complete files their names, and wait until the disk has these."""
        for name in files:
            (self.root / name).parent.mkdir(parents=True, exist_ok=True)
        for name, staged in files.items():
            self.storage.place(staged, self.root / name)
        for folder in {(self.root / name).parent for name in files}:
            self.storage.sync_path(folder)


def _free(path: Path) -> Path:
    """Return the path, or one beside it that is not taken: what was put aside before stays."""
    names = itertools.chain([path.name], (f"{path.stem}-{number}{path.suffix}" for number in itertools.count(2)))
    return next(each for name in names if not (each := path.with_name(name)).exists())


def _parquet(table: pa.Table) -> Callable[[IO[bytes]], object]:
    return lambda file: pq.write_table(table, file, compression="snappy")


def _json(value: object) -> Callable[[IO[bytes]], object]:
    return lambda file: file.write(json.dumps(value, indent=4).encode())
