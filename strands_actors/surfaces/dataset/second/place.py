"""The second place of a dataset, to which its episodes are copied: a folder, an object store, or the Hub.

A place stores files under the names that they have in the dataset. Every file in it is complete or missing.
"""

from __future__ import annotations

import contextlib
import io
import os
import shutil
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import IO, Protocol

import pyarrow as pa
from pyarrow.fs import FileSelector, FileSystem, FileType

from strands_actors.contract.shown import shown
from strands_actors.surfaces.dataset.errors import DatasetError
from strands_actors.surfaces.dataset.layout import STAGING
from strands_actors.surfaces.dataset.storage import Lock, Storage

HUB = "hf://datasets/"
SCHEMES = ("s3", "gs", "gcs")
"""Object stores that pyarrow can reach. ``fsspec+NAME`` stands for any file system of fsspec."""
FSSPEC = "fsspec+"
CHUNK = 1 << 20
PART = STAGING / "copied.part"
"""Name in the folder of the file that is being written."""

Source = Path | bytes
"""The contents of a file: a local file, or the bytes."""


class PlaceError(DatasetError):
    """The second place cannot be used at the moment. It is full, read-only, gone or not reachable. Its files are
    complete, and copying can go on later."""


class Place(Protocol):
    """Where the copy of a dataset is. Any method may raise ``PlaceError``.

    Attributes:
        url: The place as the user named it.
        is_atomic: True if ``put`` writes all its files at once, or fails without a change.
    """

    url: str
    is_atomic: bool

    def sizes(self) -> dict[str, int]:
        """Return the size of every file in bytes, by its name, such as ``meta/info.json``."""

    def open(self, name: str) -> contextlib.AbstractContextManager[IO[bytes]]:
        """Open a file for reading. Raise ``PlaceError`` if it is missing."""

    def put(self, files: Mapping[str, Source], note: str) -> None:
        """Write files in this order, and replace files of the same names. ``note`` describes them."""

    def close(self) -> None: ...


def require_url(url: str, root: Path) -> None:
    """Check the URL of a second place, without any I/O on the place.

    Args:
        url: A folder, ``s3://bucket/folder``, ``hf://datasets/user/name``, or ``fsspec+NAME://...``.
        root: The folder of the dataset.

    Raises:
        DatasetError: The URL is not of this form, or the second place is the dataset itself.
    """
    scheme, colon, rest = url.partition("://")
    if not colon:
        second, first = Path(os.path.abspath(url)), Path(os.path.abspath(root))
        if second == first or first in second.parents or second in first.parents:
            raise DatasetError(f"the second place {url} is the dataset's own folder. Give another folder")
    elif scheme == "hf":
        if not url.startswith(HUB) or len(list(filter(None, url.removeprefix(HUB).split("/")))) != 2:
            raise DatasetError(f"{shown(url)} is not a dataset of the Hub. Write {HUB}USER/NAME")
    elif scheme not in SCHEMES and not scheme.startswith(FSSPEC):
        raise DatasetError(
            f"{shown(url)}: copies to {shown(scheme)} are not supported. Give a folder, s3://BUCKET/FOLDER, "
            f"{HUB}USER/NAME, or {FSSPEC}NAME://... for a file system of fsspec"
        )
    elif "@" in rest.partition("/")[0]:
        raise DatasetError(
            "the second place has a key in its URL, which other users of this computer could read. "
            "Leave it out, and set AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY"
        )
    elif not rest.strip("/"):
        raise DatasetError(f"{shown(url)} names no folder. Write {scheme}://BUCKET/FOLDER")


def absolute_url(place: object) -> str:
    """Return a second place as a URL. A folder becomes an absolute path, because other processes use it.

    Raises:
        DatasetError: The place is neither text nor a path.
    """
    if not isinstance(place, str | os.PathLike):
        raise DatasetError(f"copy_to is {shown(place)}. Give a folder, or a URL such as s3://bucket/folder")
    text = str(os.fspath(place))
    return text if "://" in text or not text else os.path.abspath(text)


class Folder:
    """A folder, for example on another disk. Each file is written under another name, synced and renamed."""

    is_atomic = False

    def __init__(self, url: str, storage: Storage | None = None) -> None:
        self.url = url
        self._root = Path(os.path.abspath(url))
        self._storage = storage or Storage()
        try:
            if not self._root.parent.is_dir():
                # A missing disk must not be replaced by a folder on the disk below it.
                raise PlaceError(f"{url}: there is no folder {self._root.parent}. Mount its disk, or make it")
            self._root.mkdir(0o700, exist_ok=True)
            self._lock = Lock(self._root)
        except PlaceError:
            raise
        except DatasetError as taken:
            raise PlaceError(str(taken)) from taken
        except OSError as failure:
            raise _unreachable(url, failure) from failure

    def sizes(self) -> dict[str, int]:
        with self._reaching() as root:
            return {
                str(path.relative_to(root)): path.stat().st_size
                for path in root.rglob("*")
                if path.is_file() and STAGING.name not in path.parts
            }

    def open(self, name: str) -> IO[bytes]:
        with self._reaching() as root:
            return (root / name).open("rb")

    def put(self, files: Mapping[str, Source], note: str) -> None:
        for name, source in files.items():
            with self._reaching() as root:
                with _opened(source) as contents, self._storage.create(root / PART) as file:
                    shutil.copyfileobj(contents, file, CHUNK)
                    self._storage.sync(file)
                self._storage.place(root / PART, root / name)
                self._storage.sync_path((root / name).parent)

    def close(self) -> None:
        with contextlib.suppress(OSError):  # The disk may be gone.
            (self._lock.inside / PART).unlink(missing_ok=True)
            (self._lock.inside / STAGING).rmdir()
        self._lock.release()

    @contextlib.contextmanager
    def _reaching(self) -> Iterator[Path]:
        """Yield the folder, and turn errors of its disk into ``PlaceError``."""
        try:
            if not self._lock.is_of(self._root):
                raise PlaceError(f"{self.url} was moved, or its disk was unmounted. Put it back")
            yield self._lock.inside
        except OSError as failure:
            raise _unreachable(self.url, failure) from failure


class Objects:
    """A folder in an object store, or in a file system of fsspec. Only complete files are visible."""

    is_atomic = False

    def __init__(self, url: str) -> None:
        self.url = url
        try:
            self._store, base = FileSystem.from_uri(url)
        except (ImportError, ValueError) as unusable:
            raise DatasetError(f"{url} cannot be used: {_one_line(unusable)}") from unusable
        except (OSError, pa.ArrowException) as failure:
            raise PlaceError(f"{url}: {_one_line(failure)}") from failure
        self._base = base.rstrip("/")

    def sizes(self) -> dict[str, int]:
        with self._reaching():
            files = self._store.get_file_info(FileSelector(self._base, recursive=True, allow_not_found=True))
            start = len(self._base) + 1
            return {file.path[start:]: file.size for file in files if file.type is FileType.File}

    @contextlib.contextmanager
    def open(self, name: str) -> Iterator[IO[bytes]]:
        with self._reaching(), self._store.open_input_stream(f"{self._base}/{name}") as stream:
            yield stream

    def put(self, files: Mapping[str, Source], note: str) -> None:
        with self._reaching():
            for name, source in files.items():
                with _opened(source) as contents, self._store.open_output_stream(f"{self._base}/{name}") as stream:
                    while chunk := contents.read(CHUNK):
                        stream.write(chunk)

    def close(self) -> None:
        """Do nothing. The store keeps no connection that must be closed."""

    @contextlib.contextmanager
    def _reaching(self) -> Iterator[None]:
        try:
            yield
        except (OSError, pa.ArrowException) as failure:
            raise PlaceError(f"{self.url}: {_one_line(failure)}") from failure


def _opened(source: Source) -> IO[bytes]:
    return io.BytesIO(source) if isinstance(source, bytes) else source.open("rb")


def _unreachable(url: str, failure: OSError) -> PlaceError:
    return PlaceError(f"{url}: {failure.strerror or failure}")


def _one_line(failure: BaseException) -> str:
    return " ".join(str(failure).split())[:300]
