"""Read XML as MuJoCo's reader does, and change parts of it in place. Pure.

MuJoCo's reader takes names as they are written. A prefix needs no declaration (``drake:``, plugins of
Gazebo). An entity that XML does not define stays unchanged. Everything after the first element is ignored.
A standard parser refuses such files. Here each element keeps its place in the text, so that a caller can
replace an attribute and leave every other character unchanged.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from typing import NamedTuple

MAX_DEPTH = 500
"""Deepest nesting of elements: the limit of MuJoCo's reader."""

_TAG = re.compile(r"<(/?)([^\s/>\"'=<]+)((?:[^\"'>]|\"[^\"]*+\"|'[^']*+')*+)>")
_ATTRIBUTE = re.compile(r"([^\s=/>\"']++)(?:\s*+=\s*+(?:\"([^\"]*+)\"|'([^']*+)'))?+")
"""It also matches a word without a value, so that a long text without values is read only once."""
_ENTITY = re.compile(r"&(lt|gt|amp|quot|apos|#\d{1,7}|#x[0-9a-fA-F]{1,6});")
_NAMED = {"lt": "<", "gt": ">", "amp": "&", "quot": '"', "apos": "'"}
_SKIPPED = (("<!--", "-->"), ("<![CDATA[", "]]>"), ("<?", "?>"), ("<!", ">"))
"""Beginning and end of parts that are no elements. The order matters, since the last one begins like the
first two."""


class NotXml(ValueError):
    """The text is no XML. The message has the error and its line."""


class Attribute(NamedTuple):
    value: str
    start: int  # place of the whole attribute in the text
    end: int


class Element:
    """One element. ``start`` and ``end`` are its place in the text; ``inside`` is the place after its
    name."""

    __slots__ = ("attributes", "children", "end", "inside", "start", "tag")

    def __init__(self, tag: str, attributes: dict[str, Attribute], start: int, inside: int, end: int) -> None:
        self.tag = tag
        self.attributes = attributes
        self.children: list[Element] = []
        self.start = start
        self.inside = inside
        self.end = end

    def get(self, name: str, default: str = "") -> str:
        """Return the value of an attribute."""
        found = self.attributes.get(name)
        return default if found is None else found.value

    def all(self, tag: str) -> list[Element]:
        """Return the children with this name."""
        return [child for child in self.children if child.tag == tag]

    def first(self, *tags: str) -> Element | None:
        """Return the first child with the first name, then its first child with the second name, and so on."""
        found: Element | None = self
        for tag in tags:
            found = next(iter(found.all(tag)), None) if found is not None else None
        return found

    def iterate(self, tag: str) -> Iterator[Element]:
        """Yield all elements with this name inside this one, in the order of the text."""
        waiting = self.children[::-1]
        while waiting:
            element = waiting.pop()
            if element.tag == tag:
                yield element
            waiting.extend(reversed(element.children))


class Edit(NamedTuple):
    """Replace ``text[start:end]`` by ``text``."""

    start: int
    end: int
    text: str


def parse(text: str) -> Element:
    """Return the first element of a text, in a time that grows with its length. Raise ``NotXml``."""
    opened: list[Element] = []
    at = 0
    while (at := text.find("<", at)) >= 0:
        if (skipped := _skipped(text, at)) is not None:
            at = skipped
            continue
        tag = _TAG.match(text, at)
        if tag is None:
            raise NotXml(f"line {_line(text, at)}: a tag has no end")
        closes, name, inside = tag.groups()
        at = tag.end()
        if closes:
            if not opened or opened[-1].tag != name:
                raise NotXml(f"line {_line(text, tag.start())}: </{name}> closes no element that is open")
            element = opened.pop()
            element.end = at
        else:
            element = Element(name, _attributes(inside, tag.start(3)), tag.start(), tag.end(2), at)
            if opened:
                opened[-1].children.append(element)
            if not inside.endswith("/"):
                opened.append(element)
            if len(opened) > MAX_DEPTH:
                raise NotXml(f"line {_line(text, tag.start())}: elements are nested more than {MAX_DEPTH} deep")
        if not opened:
            return element
    if opened:
        raise NotXml(f"line {_line(text, opened[-1].start)}: <{opened[-1].tag}> is never closed")
    raise NotXml("there is no element in it")


def edited(text: str, edits: Iterable[Edit]) -> str:
    """Return the text with all edits applied. They must not overlap."""
    parts, at = [], 0
    for start, end, new in sorted(edits):
        parts += [text[at:start], new]
        at = end
    return "".join([*parts, text[at:]])


def escaped(value: str) -> str:
    """Return a value in the form that it needs between double quotes."""
    return value.replace("&", "&amp;").replace("<", "&lt;").replace('"', "&quot;")


def _skipped(text: str, at: int) -> int | None:
    """Return the end of a comment or similar part that begins here; None if there is no such part."""
    for begin, end in _SKIPPED:
        if text.startswith(begin, at):
            found = text.find(end, at + len(begin))
            if found < 0:
                raise NotXml(f"line {_line(text, at)}: {begin} has no end")
            return found + len(end)
    return None


def _attributes(inside: str, offset: int) -> dict[str, Attribute]:
    found: dict[str, Attribute] = {}
    for match in _ATTRIBUTE.finditer(inside):
        name, double, single = match.groups()
        value = single if double is None else double
        if value is None:
            continue
        found.setdefault(name, Attribute(_plain(value), offset + match.start(), offset + match.end()))
    return found


def _plain(value: str) -> str:
    return _ENTITY.sub(_character, value) if "&" in value else value


def _character(entity: re.Match[str]) -> str:
    name = entity[1]
    if not name.startswith("#"):
        return _NAMED[name]
    code = int(name[2:], 16) if name[1] == "x" else int(name[1:])
    return chr(code) if 0 < code <= 0x10FFFF else entity[0]


def _line(text: str, at: int) -> int:
    return text.count("\n", 0, at) + 1
