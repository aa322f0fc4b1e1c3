"""Draw the diagrams of the pages: ``python -m docs.site.diagrams``.

GitHub draws a block of Mermaid in the reader's browser, with a script of three megabytes. The site shows pictures
that were drawn before, because it loads nothing from a network. After a change of a diagram, draw it anew. The
build fails if a picture is older than its diagram.

Drawing needs the package ``mermaidx``, which runs Mermaid itself. Building the site does not need it.
"""

from __future__ import annotations

import hashlib
import re
import sys
from pathlib import Path

from .build import ROOT

MERMAID = re.compile(r"^```mermaid\n(.*?)^```$", re.DOTALL | re.MULTILINE)
FOLDER = "diagrams"
INSTALL = "pip install mermaidx"
COMMAND = "python -m docs.site.diagrams"


class Missing(Exception):
    """A diagram of a page was not drawn since it was changed."""


def drawing_of(place: str, number: int, source: str) -> str:
    """Return the path, in ``docs/``, of the picture of a diagram.

    Args:
        place: The path of the page in ``docs/``.
        number: Number of the diagram in its page, from 1.
        source: The text of the diagram.

    Raises:
        Missing: There is no picture, or it was drawn from another text.
    """
    path = _path(place, number)
    picture = ROOT / "docs" / path
    if not picture.is_file() or _mark(source) not in picture.read_text():
        raise Missing(f"{place}: diagram {number} has no picture. Run: {INSTALL} && {COMMAND}")
    return path


def _path(place: str, number: int) -> str:
    return f"{FOLDER}/{place.removesuffix('.md').replace('/', '-')}-{number}.svg"


def _mark(source: str) -> str:
    """Return the comment that a picture has at its end: a hash of the text from which it was drawn."""
    return f"<!-- {hashlib.sha256(source.encode()).hexdigest()[:16]} -->"


def pages() -> list[Path]:
    """Return the pages of ``docs/`` that have diagrams."""
    return [path for path in sorted((ROOT / "docs").rglob("*.md")) if MERMAID.search(path.read_text())]


def _sized(picture: str) -> str:
    """Return a picture with its width and height, which Mermaid leaves to the page around it."""
    box = re.search(r'viewBox="[\d.-]+ [\d.-]+ ([\d.]+) ([\d.]+)"', picture)
    if box is None:
        raise ValueError("the picture has no viewBox")
    size = f'width="{float(box[1]):.0f}" height="{float(box[2]):.0f}"'
    return picture.strip().replace('width="100%"', size, 1)


def main() -> int:
    """Draw each diagram that has no picture, and delete the pictures without a diagram."""
    docs = ROOT / "docs"
    kept: set[Path] = set()
    for page in pages():
        place = page.relative_to(docs).as_posix()
        for number, source in enumerate(MERMAID.findall(page.read_text()), 1):
            picture = docs / _path(place, number)
            kept.add(picture)
            try:
                drawing_of(place, number, source)
            except Missing:
                try:
                    from mermaidx import render
                except ImportError:
                    print(f"docs: mermaidx is not installed. Run: {INSTALL}", file=sys.stderr)
                    return 1
                picture.parent.mkdir(exist_ok=True)
                picture.write_text(f"{_sized(render(source).svg())}\n{_mark(source)}\n")
                print(picture.relative_to(ROOT))
    for picture in sorted({*(docs / FOLDER).glob("*.svg")} - kept):
        picture.unlink()
    return 0


if __name__ == "__main__":
    sys.exit(main())
