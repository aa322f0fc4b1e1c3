"""Copy a dataset into few files, and convert a dataset of an older version of LeRobot's format."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import msgspec

from .copying import Copied, copy_dataset
from .errors import DatasetError
from .index import Index
from .info import VERSION, Feature, Info
from .layout import DATA_MB, DATA_PATH, INFO, VIDEO_MB, VIDEO_PATH
from .storage import Storage

OLDER_TOTALS = ("total_videos", "total_chunks")


def compact(root: Path, copy: Path, storage: Storage | None = None) -> Copied:
    """Copy a dataset of version 3 into few files.

    Args:
        root: The folder of the dataset.
        copy: The folder of the copy, which must not exist.
        storage: The disk; a test may replace it.

    Raises:
        DatasetError: ``copy_dataset`` has failed, or the dataset has an older version.
    """
    index, info = open_newest(root)
    return copy_dataset(index, copy, info.document, storage)


def convert(root: Path, copy: Path, storage: Storage | None = None) -> Copied:
    """Copy a dataset of version 2.0 or 2.1 as version 3, without encoding a picture again.

    Args:
        root: The folder of the dataset.
        copy: The folder of the copy, which must not exist.
        storage: The disk; a test may replace it.

    Raises:
        DatasetError: ``copy_dataset`` has failed, or the dataset has version 3 already.
    """
    index, info = open_dataset(root)
    if not info.is_older:
        raise DatasetError(f"{root} has version {VERSION} already. Use `strands-actors dataset compact` to copy it")
    return copy_dataset(index, copy, _newer(info), storage)


def open_dataset(root: Path) -> tuple[Index, Info]:
    """Read the index of a dataset. Raise ``DatasetError`` if the folder is not one."""
    index = Index(root)
    if index.info is None:
        raise DatasetError(f"{root} is not a dataset, because it has no {INFO}. Give the folder of a dataset")
    return index, index.info


def open_newest(root: Path) -> tuple[Index, Info]:
    """Read the index of a dataset of version 3. Raise ``DatasetError`` if it has an older version."""
    index, info = open_dataset(root)
    if info.is_older:
        raise DatasetError(
            f"{root} has the older version {info.codebase_version}. Use `strands-actors dataset convert`"
        )
    return index, info


def _newer(info: Info) -> dict[str, Any]:
    """Return the contents of ``info.json``, converted to version 3."""
    features = {key: _feature(feature, info) for key, feature in info.features.items()}
    kept = {key: value for key, value in info.document.items() if key not in OLDER_TOTALS}
    return kept | {
        "codebase_version": VERSION,
        "fps": int(info.fps) if info.fps == int(info.fps) else info.fps,
        "data_files_size_in_mb": DATA_MB,
        "video_files_size_in_mb": VIDEO_MB,
        "data_path": DATA_PATH,
        "video_path": VIDEO_PATH if info.videos else None,
        "features": features,
    }


def _feature(feature: Feature, info: Info) -> dict[str, Any]:
    fields: dict[str, Any] = msgspec.to_builtins(feature)
    if feature.units is None:
        del fields["units"]
    del fields["video_info"]
    if feature.dtype == "video":
        fields["info"] = feature.info or feature.video_info or {}
    else:
        del fields["info"]
        fields["fps"] = info.fps
    return fields
