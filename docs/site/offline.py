"""Check that a site loads nothing from a network when a page is opened."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

ELEMENT = re.compile(r"<(?:script|img|iframe|source|video|audio|embed|link|image)\b[^>]*>", re.IGNORECASE)
"""Elements that load a file at once. A link to click (``a``) does not."""
ADDRESS = re.compile(r"""\b(?:src|href|srcset|data)\s*=\s*["']?\s*((?:https?:)?//[^\s"'>]+)""", re.IGNORECASE)
ONLY_NAMES = re.compile(r"""\brel\s*=\s*["']?(?:canonical|next|prev|alternate)\b""")
"""Kinds of ``link`` that only name another page."""
OF_STYLES = re.compile(r"""(?:url\(\s*["']?|@import\s+["'])((?:https?:)?//[^\s"')]+)""")


def loaded(page: str) -> list[str]:
    """Return the addresses of other hosts that the HTML of a page loads."""
    elements = (match[0] for match in ELEMENT.finditer(page))
    found = [ADDRESS.search(element) for element in elements if not ONLY_NAMES.search(element)]
    return [match[1] for match in found if match]


def foreign_resources(site: Path) -> list[str]:
    """Return the addresses of other hosts that a page or style sheet of a site loads, each with its file."""
    return [f"{path.relative_to(site)}: {address}" for path, address in _addresses(site)]


def _addresses(site: Path) -> Iterator[tuple[Path, str]]:
    for path in sorted(site.rglob("*.html")):
        yield from ((path, address) for address in loaded(path.read_text()))
    for path in sorted(site.rglob("*.css")):
        yield from ((path, address) for address in OF_STYLES.findall(path.read_text()))
