"""A URDF as text that MuJoCo reads, with its meshes beside it. Nothing is downloaded: a mesh is
where the file says, or in a package folder above it."""

from __future__ import annotations

import re
from pathlib import Path
from xml.etree import ElementTree

READABLE = (".stl", ".obj", ".msh")
"""Meshes that MuJoCo reads."""

PACKAGE = re.compile(r"^(?:package|model)://([^/]+)/(.*)$")


def readable_urdf(path: Path) -> tuple[str, dict[str, bytes]]:
    """Return the text and its meshes by the names in it. A visual whose mesh MuJoCo does not read
    (Collada) is left out where the link has a collision shape. Raise ``ValueError``."""
    try:
        root = ElementTree.parse(path).getroot()
    except ElementTree.ParseError as error:
        raise ValueError(f"{path} is no XML: {error}") from None
    if root.tag != "robot":
        raise ValueError(f"{path} is no URDF: it begins with <{root.tag}>, not <robot>")
    meshes: dict[str, bytes] = {}
    for link in root.iter("link"):
        for shape in [*link.findall("visual"), *link.findall("collision")]:
            mesh = shape.find("geometry/mesh")
            if mesh is None:
                continue
            told = mesh.get("filename", "")
            if Path(told).suffix.lower() not in READABLE:
                _leave_out(path, link, shape, told)
                continue
            found = _find(path, told)
            name = f"mesh{len(meshes)}{found.suffix.lower()}"
            meshes[name] = found.read_bytes()
            mesh.set("filename", name)
    _set_compiler(root)
    return ElementTree.tostring(root, encoding="unicode"), meshes


def _leave_out(path: Path, link: ElementTree.Element, shape: ElementTree.Element, told: str) -> None:
    if shape.tag == "visual" and link.find("collision") is not None:
        link.remove(shape)
        return
    raise ValueError(
        f"{path}: link {link.get('name')} has the mesh {told!r}, which MuJoCo does not read. "
        f"convert it to {', '.join(READABLE)}"
    )


def _find(path: Path, told: str) -> Path:
    """The mesh's file. Raise ``ValueError`` that says where it was looked for."""
    package = PACKAGE.match(told)
    if package is not None:
        name, rest = package.groups()
        places = [above / rest for above in path.parents if above.name == name]
        places += [above / name / rest for above in path.parents] + [above / rest for above in path.parents]
    else:
        plain = told.removeprefix("file://")
        places = [path.parent / plain]
    for place in places:
        if place.is_file():
            return place
    raise ValueError(f"{path} names the mesh {told!r}, which is not there. it was looked for as {places[0]}")


def _set_compiler(root: ElementTree.Element) -> None:
    """MuJoCo's own part of a URDF: keep what is seen, and every link and name."""
    extension = root.find("mujoco")
    if extension is None:
        extension = ElementTree.SubElement(root, "mujoco")
    compiler = extension.find("compiler")
    if compiler is None:
        compiler = ElementTree.SubElement(extension, "compiler")
    for key, value in (("discardvisual", "false"), ("strippath", "false"), ("fusestatic", "false")):
        compiler.set(key, compiler.get(key, value))
    compiler.set("strippath", "false")  # the names are ours
    compiler.attrib.pop("meshdir", None)
