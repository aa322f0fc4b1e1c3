"""Read the manifest of a folder with an ONNX policy."""

from __future__ import annotations

from pathlib import Path

import msgspec

from .manifest import FILE, MOST_BYTES, Manifest, read_manifest
from .microduck import is_of_microduck, read_microduck


def manifest_of(folder: Path, skill: str | None = None) -> Manifest | None:
    """Return the manifest of a folder.

    Args:
        folder: The folder, with ``manifest.json``.
        skill: The policy of a set, by its name; empty if the manifest has only one. None if the user has not chosen
            yet: the result is then None for a set.

    Raises:
        ValueError: The manifest cannot be read or is wrong, or the file of its network is missing.
    """
    path = folder / FILE
    try:
        with path.open("rb") as file:
            content = file.read(MOST_BYTES + 1)
    except OSError as failure:
        raise ValueError(
            f"{path} cannot be read: {failure.strerror}. Put the manifest beside the network"
        ) from failure
    if len(content) > MOST_BYTES:
        raise ValueError(f"{path} is larger than {MOST_BYTES} bytes. Give the manifest of a policy")
    keys = _keys(path, content)
    if not is_of_microduck(keys):
        if skill:
            raise ValueError(f"{path} has one policy. Leave skill out")
        manifest = read_manifest(content)
    elif "policies" in keys and skill is None:
        return None
    else:
        manifest = read_microduck(content, skill or "")
    if not (folder / manifest.file).is_file():
        raise ValueError(f"{path} names {manifest.file}, and {folder} has no such file. Put it there")
    return manifest


def _keys(path: Path, content: bytes) -> set[str]:
    try:
        return set(msgspec.json.decode(content, type=dict[str, msgspec.Raw]))
    except (msgspec.DecodeError, RecursionError) as failure:
        raise ValueError(f"{path} is no JSON object: {failure}") from failure


__all__ = ["manifest_of"]
