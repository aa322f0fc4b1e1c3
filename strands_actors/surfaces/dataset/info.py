"""What a dataset says of itself in ``info.json``, checked once: another program wrote it, or nobody knows
who. What it says of other files is believed nowhere but where they are opened. Pure."""

from __future__ import annotations

import re
from typing import Annotated, Any

import msgspec

from .errors import DatasetError

VERSION = "v3.0"
_NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_. -]{0,199}")
"""What a feature may be called: it is a folder's name."""
Count = Annotated[int, msgspec.Meta(ge=0)]


class Feature(msgspec.Struct):
    dtype: str
    shape: list[Annotated[int, msgspec.Meta(ge=0)]]
    names: Any = None
    info: dict[str, Any] | None = None


class Info(msgspec.Struct):
    codebase_version: str
    fps: Annotated[float, msgspec.Meta(gt=0, le=10_000)]
    features: dict[str, Feature]
    total_episodes: Count = 0
    total_frames: Count = 0
    total_tasks: Count | None = None  # None: all that its table of tasks has


def decode_info(data: bytes, file: object) -> dict[str, Any]:
    """Return what ``info.json`` says, with the counts that are not told as 0.

    Args:
        data: The file's bytes.
        file: Where it is, for people.

    Raises:
        DatasetError: It is no JSON, of another version, or a value is none that can be.
    """
    try:
        said = msgspec.json.decode(data)
    except (msgspec.DecodeError, RecursionError, UnicodeError) as damage:
        raise DatasetError(f"{file} is damaged: {damage}") from damage
    version = said.get("codebase_version") if isinstance(said, dict) else None
    if version != VERSION:
        raise DatasetError(f"{file}: a dataset of version {version}; this reads and writes {VERSION}")
    try:
        info = msgspec.convert(said, Info)
    except msgspec.ValidationError as wrong:
        raise DatasetError(f"{file}: {wrong}") from wrong
    for key, feature in info.features.items():
        if not _NAME.fullmatch(key):
            raise DatasetError(f"{file}: a feature is called {key[:60]!r}, which is no name of a folder")
        if feature.dtype == "video" and len(feature.shape) != 3:
            raise DatasetError(f"{file}: {key} is a video of shape {feature.shape}. give height, width, channels")
    return {"total_episodes": 0, "total_frames": 0, **said}
