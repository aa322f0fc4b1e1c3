"""Render pages as GitHub does: the same anchors, nested lists, and diagrams.

The pages are read on GitHub, too, so the site adapts and the pages stay as they are.
"""

from __future__ import annotations

import html
import re
from collections.abc import Callable

from .diagrams import MERMAID, drawing_of
from .sources import outside_fences

NESTED = re.compile(r"^ {2,3}(?=[*-] )", re.MULTILINE)
TABLE = re.compile(r"<table>.*?</table>", re.DOTALL)


def slug(heading: str, separator: str) -> str:
    """Return the anchor that GitHub makes of a heading.

    Args:
        heading: The heading as text.
        separator: The sign between two words.
    """
    return re.sub(r"[^\w\- ]", "", heading.lower()).strip().replace(" ", separator)


def adapted(text: str, place: str, file_of: Callable[[str], str]) -> str:
    """Return the text of a page for Python-Markdown.

    Args:
        text: The text for GitHub.
        place: The place of the page in the site.
        file_of: Returns the link from the page to a file of ``docs/``.

    Raises:
        Missing: A diagram of the page was not drawn.
    """
    numbers = iter(range(1, len(MERMAID.findall(text)) + 1))

    def drawn(match: re.Match[str]) -> str:
        number = next(numbers)
        picture = drawing_of(place, number, match[1])
        title = html.escape(f"Diagram {number} of this page")
        return f'<div class="diagram"><img src="{file_of(picture)}" alt="{title}"></div>'

    # GitHub nests a list by two spaces, Python-Markdown by four.
    return outside_fences(MERMAID.sub(drawn, text), lambda prose: NESTED.sub("    ", prose))


def wide_tables(page: str) -> str:
    """Return the HTML of a page with each table in a box that scrolls, so that the page fits a narrow screen."""
    return TABLE.sub(lambda table: f'<div class="wide">{table[0]}</div>', page)
