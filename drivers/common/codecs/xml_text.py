"""Read XML as MuJoCo's reader does, and change parts of the text in place. Pure.

MuJoCo's reader is more tolerant than a standard parser, which refuses such files. It needs no declaration of a
prefix (``drake:``, plugins of Gazebo). It leaves an entity that XML does not define unchanged. It ignores
everything after the first element. Each element that this module returns knows its position in the text, so that a
caller can replace an attribute and leave every other character unchanged.
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
    """The text is not valid XML. The exception's text has the error and its line."""


class Attribute(NamedTuple):
    value: str
    start: int  # offset of the whole attribute (name, ``=`` and value) in the text
    end: int


class Element:
    """One XML element. ``start`` and ``end`` are its first and last offset in the text, ``inside`` is the offset
    after its name."""

    __slots__ = ("attributes", "children", "end", "inside", "start", "tag")

    def __init__(self, tag: str, attributes: dict[str, Attribute], start: int, inside: int, end: int) -> None:
        self.tag = tag
        self.attributes = attributes
        self.children: list[Element] = []
        self.start = start
        self.inside = inside
        self.end = end

    def get(self, name: str, default: str = "") -> str:
        """Return the value of the attribute ``name``; ``default`` if the element does not have it."""
        attribute = self.attributes.get(name)
        return default if attribute is None else attribute.value

    def all(self, tag: str) -> list[Element]:
        """Return the direct children with this tag."""
        return [child for child in self.children if child.tag == tag]

    def first(self, *tags: str) -> Element | None:
        """Descend by one child per tag: the first child with the first tag, then its first child with the second,
        and so on. Return None if one is missing."""
        element: Element | None = self
        for tag in tags:
            element = next(iter(element.all(tag)), None) if element is not None else None
        return element

    def iterate(self, tag: str) -> Iterator[Element]:
        """Yield all elements with this tag below this element, in the order of the text."""
        waiting = self.children[::-1]
        while waiting:
            element = waiting.pop()
            if element.tag == tag:
                yield element
            waiting.extend(reversed(element.children))


class Edit(NamedTuple):
    """An edit of a text: replace ``text[start:end]`` by the new ``text``."""

    start: int
    end: int
    text: str


def parse(text: str) -> Element:
    """Return the first element of a text. Parsing takes time in proportion to the length of the text. Raise
    ``NotXml`` if the text is not valid XML."""
    opened: list[Element] = []
    offset = 0
    while (offset := text.find("<", offset)) >= 0:
        if (skipped := _skipped(text, offset)) is not None:
            offset = skipped
            continue
        tag = _TAG.match(text, offset)
        if tag is None:
            raise NotXml(f"line {_line(text, offset)}: a tag has no end")
        closes, name, inside = tag.groups()
        offset = tag.end()
        if closes:
            if not opened or opened[-1].tag != name:
                raise NotXml(f"line {_line(text, tag.start())}: </{name}> closes no element that is open")
            element = opened.pop()
            element.end = offset
        else:
            element = Element(name, _attributes(inside, tag.start(3)), tag.start(), tag.end(2), offset)
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
    """Return the text with all edits applied. The edits must not overlap."""
    parts, offset = [], 0
    for start, end, new in sorted(edits):
        parts += [text[offset:start], new]
        offset = end
    return "".join([*parts, text[offset:]])


def escaped(value: str) -> str:
    """Escape the value of an XML attribute, so that it can be written between double quotes."""
    return value.replace("&", "&amp;").replace("<", "&lt;").replace('"', "&quot;")


def _skipped(text: str, offset: int) -> int | None:
    """Return the end of a comment, CDATA section or declaration that begins at ``offset``; None if there is no such
    part."""
    for begin, end in _SKIPPED:
        if text.startswith(begin, offset):
            close_offset = text.find(end, offset + len(begin))
            if close_offset < 0:
                raise NotXml(f"line {_line(text, offset)}: {begin} has no end")
            return close_offset + len(end)
    return None


def _attributes(inside: str, offset: int) -> dict[str, Attribute]:
    attributes: dict[str, Attribute] = {}
    for match in _ATTRIBUTE.finditer(inside):
        name, double, single = match.groups()
        value = single if double is None else double
        if value is None:
            continue
        attributes.setdefault(name, Attribute(_plain(value), offset + match.start(), offset + match.end()))
    return attributes


def _plain(value: str) -> str:
    return _ENTITY.sub(_character, value) if "&" in value else value


def _character(entity: re.Match[str]) -> str:
    name = entity[1]
    if not name.startswith("#"):
        return _NAMED[name]
    code = int(name[2:], 16) if name[1] == "x" else int(name[1:])
    return chr(code) if 0 < code <= 0x10FFFF else entity[0]


def _line(text: str, offset: int) -> int:
    return text.count("\n", 0, offset) + 1
