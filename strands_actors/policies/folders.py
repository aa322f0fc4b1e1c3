"""Find out which policy a folder holds, by the names of its files. No file is loaded here.

    config.json                        a checkpoint of lerobot, with the weights in model.safetensors
    manifest.json                      a network in the ONNX format, with the description of its inputs and outputs
    *.pt, *.pth, *.pkl, *.bin, ...     refused: reading such a file can run code that it contains

Model files are data for this package: safetensors and ONNX. A file in Python's pickle format is a program. So a
checkpoint in that format is refused, with instructions to convert it.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

from .lerobot import FILES, checkpoint_folder
from .onnx.folder import manifest_of
from .onnx.manifest import FILE

LEROBOT = "lerobot_local"
ONNX = "onnx"
CONFIG, WEIGHTS = FILES[:2]
PICKLES = frozenset({".bin", ".ckpt", ".joblib", ".pickle", ".pkl", ".pt", ".pth"})
"""Endings of files that torch, joblib and others write in Python's pickle format."""
MOST_FILES = 10_000
"""Most files of a folder that are looked at. A checkpoint has fewer than a hundred."""
PARTS = ("pretrained_model", "checkpoints/last/pretrained_model")
"""Where lerobot-train puts the checkpoint, in its output folder."""


class FolderPolicy(NamedTuple):
    """The policy that a folder holds.

    Attributes:
        provider: Its name, as in ``registry.PROVIDERS``.
        options: Keyword arguments of the policy that name the folder.
        hz: Actions per second, if the folder states a rate; else None.
    """

    provider: str
    options: dict[str, Any]
    hz: float | None = None


def read_folder(path: Path) -> FolderPolicy:
    """Return which policy a folder holds.

    Args:
        path: The folder.

    Raises:
        ValueError: It holds no policy that this package can read. The text names the reason and the remedy.
    """
    names = _names(path)
    if CONFIG in names and WEIGHTS in names:
        return FolderPolicy(LEROBOT, {"pretrained_name_or_path": checkpoint_folder(str(path))})
    if FILE in names:
        manifest = manifest_of(path)
        return FolderPolicy(ONNX, {"folder": str(path)}, None if manifest is None else manifest.control_hz)
    if networks := sorted(name for name in names if name.endswith(".onnx")):
        raise ValueError(f"{path / networks[0]} has no {FILE} beside it. Write one: docs/policies.md describes it")
    if pickles := sorted(name for name in names if Path(name).suffix.lower() in PICKLES):
        raise ValueError(pickle_refusal(path, pickles[0]))
    for part in PARTS:
        if (path / part / WEIGHTS).is_file():
            raise ValueError(f"{path} is a training folder of lerobot. Give its checkpoint: {path / part}")
    has = ", ".join(sorted(names)[:5]) or "no files"
    raise ValueError(
        f"{path} holds no policy ({has}). Give a folder with {CONFIG} and {WEIGHTS} of lerobot, or with {FILE} "
        "and an ONNX network"
    )


def pickle_refusal(folder: Path, name: str) -> str:
    """Return the text of the refusal of a file in Python's pickle format."""
    return (
        f"{folder / name} is in Python's pickle format, and reading such a file can run code. Convert it on a "
        "computer where that is no risk: save its weights by safetensors.torch.save_file or save_pretrained of "
        "lerobot, or the whole network by torch.onnx.export"
    )


def _names(path: Path) -> set[str]:
    """Return the names of the files in a folder. Raise ``ValueError`` if it cannot be listed."""
    try:
        names = {entry.name for entry, _ in zip(path.iterdir(), range(MOST_FILES), strict=False) if entry.is_file()}
    except OSError as failure:
        raise ValueError(f"{path} cannot be read: {failure.strerror}. Give a folder that you may read") from failure
    return names


__all__ = ["FolderPolicy", "pickle_refusal", "read_folder"]
