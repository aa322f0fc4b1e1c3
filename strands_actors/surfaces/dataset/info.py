"""Decode and check ``meta/info.json`` of a dataset, which any program may have written. No I/O.

What ``info.json`` states about other files may be wrong. ``check`` compares it with those files.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Any

import msgspec

from strands_actors.contract.shown import shown

from .errors import DatasetError

VERSION = "v3.0"
OLDER = ("v2.0", "v2.1")
"""Versions that ``dataset show`` and ``dataset convert`` can read."""
LONGEST_NAME = 200
CHANNELS = (1, 3, 4)

Count = Annotated[int, msgspec.Meta(ge=0, le=10**12)]


class Feature(msgspec.Struct, frozen=True):
    """A feature of a dataset: a column of the data, or a camera.

    ``names`` may be nested. Version 2.0 uses the key ``video_info`` instead of ``info``.
    """

    dtype: str
    shape: list[Count]
    names: Any = None
    info: dict[str, Any] | None = None
    video_info: dict[str, Any] | None = None
    units: Any = None

    @property
    def flat_names(self) -> list[str]:
        """The names in order, as a list without nesting."""
        return list(_strings(self.names))

    @property
    def flat_units(self) -> list[str]:
        return list(_strings(self.units))

    @property
    def codec(self) -> str:
        """The codec of a camera's videos; empty if ``info.json`` does not state it."""
        codec = (self.info or self.video_info or {}).get("video.codec")
        return codec if isinstance(codec, str) else ""

    @property
    def height_width(self) -> tuple[int, int]:
        """The height and width of a picture. In ``shape`` the channels may be first or last."""
        sides = dict(zip((name[:1].lower() for name in self.flat_names), self.shape, strict=False))
        if {"h", "w"} <= sides.keys():
            return sides["h"], sides["w"]
        first, second, last = self.shape
        is_channel_first = first in CHANNELS and last not in CHANNELS
        return (second, last) if is_channel_first else (first, second)


class _Fields(msgspec.Struct, frozen=True, kw_only=True):
    codebase_version: str
    fps: Annotated[float, msgspec.Meta(gt=0, le=10_000)]
    features: dict[str, Feature]
    robot_type: str | None = None
    total_episodes: Count | None = None
    total_frames: Count | None = None
    total_tasks: Count | None = None
    chunks_size: Annotated[int, msgspec.Meta(ge=1)] = 1000
    data_path: str | None = None
    video_path: str | None = None


class Info(_Fields, frozen=True, kw_only=True):
    """The contents of ``info.json``. A total (number of episodes, frames or tasks) that is not in the
    file is None.

    ``document`` is the whole decoded JSON. A copy of the dataset keeps its unknown fields.
    """

    document: dict[str, Any]

    @property
    def videos(self) -> list[str]:
        return [key for key, feature in self.features.items() if feature.dtype == "video"]

    @property
    def is_older(self) -> bool:
        return self.codebase_version in OLDER


def decode_info(data: bytes, file: object) -> Info:
    """Decode ``info.json``.

    Args:
        data: The file's bytes.
        file: The file's path, for messages.

    Raises:
        DatasetError: The file is not JSON, its version is not known, or a value has a wrong type or range.
    """
    try:
        document = msgspec.json.decode(data)
    except (msgspec.DecodeError, RecursionError, UnicodeError) as damage:
        raise DatasetError(f"{file} is damaged: {damage}") from damage
    version = document.get("codebase_version") if isinstance(document, dict) else None
    if version != VERSION and version not in OLDER:
        raise DatasetError(f"{file}: version {shown(version)} is not supported. Use {', '.join((VERSION, *OLDER))}")
    try:
        info = Info(**msgspec.structs.asdict(msgspec.convert(document, _Fields)), document=document)
    except (msgspec.ValidationError, RecursionError) as wrong:
        raise DatasetError(f"{file}: {wrong}") from wrong
    for key, feature in info.features.items():
        if not is_folder_name(key):
            raise DatasetError(
                f"{file}: the feature name {shown(key)} cannot be the name of a folder. Rename the feature"
            )
        if feature.dtype == "video" and (len(feature.shape) != 3 or 0 in feature.shape):
            raise DatasetError(
                f"{file}: the video {key} has the shape {feature.shape}, not height, width, channels"
            )
    return info


def is_folder_name(name: str) -> bool:
    """Return True if a name from ``info.json`` can safely be the name of a folder in the dataset. It must be
    short and printable, must not begin with a dot, and must not contain a path."""
    return (
        0 < len(name.encode(errors="replace")) <= LONGEST_NAME
        and name.isprintable()
        and not name.startswith(".")
        and not set(name) & set('/\\:*?"<>|')
    )


def _strings(names: Any) -> Iterator[str]:
    match names:
        case str():
            yield names
        case dict():
            # The names may be in a list, as in {"motors": [...]}, or be the keys, as in {"pan": 0}.
            for key, value in names.items():
                yield from _strings(value) if isinstance(value, list | dict) else (str(key),)
        case list():
            for value in names:
                yield from _strings(value)
        case None:
            return
        case _:
            yield str(names)
