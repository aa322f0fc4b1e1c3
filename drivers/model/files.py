"""Check a user's model file before MuJoCo reads it. It may be a git-lfs pointer instead of the file, or have sizes
that would fill the memory. MuJoCo's own error messages do not show these causes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from strands_actors.contract.lfs import pointer_reason
from strands_actors.drivers.common.codecs.xml_text import Element

MOST_CELLS = 1 << 26
"""Most cells of a height field or a texture: 8192 x 8192. MuJoCo makes several copies of each."""


def pointer_among(spec: Any, folder: Path) -> str:
    """Return why a mesh or picture of a model cannot be used, if it is a git-lfs pointer and not the file itself
    (``pointer_reason``). The text is for the first such file. It is empty if no file is a pointer."""
    assets = [(spec.meshdir, asset) for asset in (*spec.meshes, *spec.hfields)]
    assets += [(spec.texturedir, asset) for asset in spec.textures]
    for directory, asset in assets:
        file = folder / directory / asset.file
        if asset.file and file.is_file() and (reason := pointer_reason(file)):
            return reason
    return ""


def refuse_sizes(root: Element) -> None:
    """Raise ``ValueError`` if a height field or a texture is larger than ``MOST_CELLS``. MuJoCo would reserve its
    memory as soon as it reads the sizes."""
    for tag, across, down in (("hfield", "ncol", "nrow"), ("texture", "width", "height")):
        for element in root.iterate(tag):
            sizes = [element.get(across), element.get(down)]
            if all(size.strip().isdecimal() for size in sizes) and int(sizes[0]) * int(sizes[1]) > MOST_CELLS:
                raise ValueError(
                    f"{tag} {element.get('name')!r} has {sizes[0]} x {sizes[1]} cells. "
                    f"Give at most {MOST_CELLS} cells"
                )
