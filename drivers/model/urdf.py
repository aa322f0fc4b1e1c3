"""Rewrite a URDF so that MuJoCo reads it with its visual shapes and with the right paths of its meshes.

Nothing is downloaded. A mesh is searched where MuJoCo itself searches, and in package folders above the file.
MuJoCo by itself drops the visual shapes of a URDF. This module keeps them for the pictures. A visual shape is left
out if its mesh cannot be read.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import NamedTuple
from urllib.parse import unquote

from strands_actors.contract.lfs import pointer_reason
from strands_actors.drivers.common.codecs.xml_text import Edit, Element, edited, escaped

READABLE = (".stl", ".obj", ".msh")
"""Suffixes of meshes that MuJoCo reads."""

_PACKAGE = re.compile(r"^(?:package|model)://([^/]+)/(.*)$")
_YES = ("true", "1")


class OmittedVisual(NamedTuple):
    """A visual shape that was left out of the model."""

    link: str
    mesh: str  # file name of the mesh, as written in the URDF
    reason: str

    def __str__(self) -> str:
        return f"{self.mesh} of link {self.link} ({self.reason})"


class Urdf(NamedTuple):
    text: str
    visuals: tuple[Path, ...]  # meshes of the visual shapes that were kept
    omitted_visuals: tuple[OmittedVisual, ...]


def readable_urdf(path: Path, text: str, root: Element, unreadable: Iterable[Path] = ()) -> Urdf:
    """Return the text of the URDF for MuJoCo, with absolute paths of the meshes.

    Args:
        path: Path of the URDF file.
        text: Text of the file.
        root: The parsed text.
        unreadable: Meshes that MuJoCo cannot read. A visual shape with one of them is left out.

    Raises:
        ValueError: The mesh of a collision shape does not exist or cannot be read.
    """
    compiler = root.first("mujoco", "compiler")
    drops_visuals = compiler is not None and compiler.get("discardvisual") in _YES
    refused = dict.fromkeys(unreadable, "MuJoCo cannot read it")
    edits = _compiler_edits(root, compiler)
    visuals: list[Path] = []
    omitted: list[OmittedVisual] = []
    for link in root.all("link"):
        for shape in [*link.all("visual"), *link.all("collision")]:
            mesh = shape.first("geometry", "mesh")
            is_visual = shape.tag == "visual"
            if mesh is None or "filename" not in mesh.attributes or (is_visual and drops_visuals):
                continue
            name, start, end = mesh.attributes["filename"]
            file, reason = _find(path, name, compiler)
            reason = reason or refused.get(file, "")
            if not reason:
                edits.append(Edit(start, end, f'filename="{escaped(str(file))}"'))
                visuals += [file] if is_visual else []
            elif is_visual:
                edits.append(Edit(shape.start, shape.end, ""))
                omitted.append(OmittedVisual(link.get("name"), name, reason))
            else:
                raise ValueError(f"{path}: the collision shape of link {link.get('name')} is {name!r}: {reason}")
    return Urdf(edited(text, edits), tuple(visuals), tuple(omitted))


def _find(path: Path, name: str, compiler: Element | None) -> tuple[Path, str]:
    """Return the path of a mesh file, and why it cannot be used. The reason is empty if it can be used."""
    places = _places(path, name, compiler)
    file = next((place for place in places if place.is_file()), places[0])
    if file.suffix.lower() not in READABLE:
        return file, f"MuJoCo reads no {file.suffix or 'mesh without a suffix'}. Convert it to .stl or .obj"
    if not file.is_file():
        return file, f"it is not there. It was looked for as {file}"
    return file, pointer_reason(file)


def _places(path: Path, name: str, compiler: Element | None) -> list[Path]:
    """Return the paths at which a mesh may be, in the order in which they are tried."""
    package = _PACKAGE.match(name)
    plain = unquote(name.removeprefix("file://")) if name.startswith("file://") else name
    places = []
    if compiler is not None or package is None:
        folder = "" if compiler is None else compiler.get("meshdir") or compiler.get("assetdir")
        strips = compiler is not None and compiler.get("strippath") in _YES
        places.append(path.parent / folder / (Path(plain).name if strips else plain))
    if package is not None:
        owner, rest = package.groups()
        ours = [above / rest for above in path.parents if above.name == owner]
        ours += [above / owner / rest for above in path.parents] + [above / rest for above in path.parents]
        places = [*ours[:1], *places, *ours[1:]]
    return places


def _compiler_edits(root: Element, compiler: Element | None) -> list[Edit]:
    """Make MuJoCo keep the visual shapes and every named link, unless the file sets these options itself. MuJoCo
    must also keep the folders in the paths of the meshes, because these paths are now absolute."""
    words = {"discardvisual": "false", "fusestatic": "false"}
    if compiler is not None:
        words = {key: value for key, value in words.items() if key not in compiler.attributes}
        own = compiler.attributes.get("strippath")
        edits = [] if own is None else [Edit(own.start, own.end, "")]
        return [*edits, Edit(compiler.inside, compiler.inside, _written({**words, "strippath": "false"}))]
    new = f"<compiler{_written({**words, 'strippath': 'false'})}/>"
    extension = root.first("mujoco")
    if extension is None:
        first = root.children[0].start if root.children else root.end
        return [Edit(first, first, f"<mujoco>{new}</mujoco>")]
    if extension.children:
        return [Edit(extension.children[0].start, extension.children[0].start, new)]
    return [Edit(extension.start, extension.end, f"<mujoco>{new}</mujoco>")]


def _written(words: Mapping[str, str]) -> str:
    return "".join(f' {key}="{value}"' for key, value in words.items())
