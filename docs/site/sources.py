"""Pages made of files outside ``docs/``: README, CONTRIBUTING and others, and the source files that pages link to.

A link in a page is relative to the file in which it stands. The site has other places for some of these files,
so ``relinked`` changes the links.
"""

from __future__ import annotations

import os
import posixpath
import re
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

from .build import ROOT

LINK = re.compile(r"(?<=\]\()([^)\s]+)(?=\))")
FENCE = re.compile(r"^( *)(```+|~~~+).*?^\1\2 *$", re.DOTALL | re.MULTILINE)

MOVED: Mapping[str, str] = {
    "README.md": "index.md",
    "CONTRIBUTING.md": "contributing.md",
    "CHANGELOG.md": "changelog.md",
    "SECURITY.md": "security.md",
}
"""Files of the repository that are pages, with the place of each page in the site."""

SOURCE_FILES = "source"
"""The folder of the site with the source files that pages link to."""

LANGUAGES = {".py": "python", ".toml": "toml", ".js": "javascript", ".script": "python", ".sh": "sh"}


class Sections(NamedTuple):
    """A page that consists of sections of the README."""

    title: str
    """The title of the page; empty for the title and the first lines of the README."""
    headings: tuple[str, ...]


README_PAGES: Mapping[str, Sections] = {
    "index.md": Sections("", ("Why", "Robots", "More")),
    "python.md": Sections("Python", ("Python", "On the robot's computer")),
    "command-line.md": Sections("Command line", ("Command line",)),
    "recording.md": Sections("Record and replay", ("Record and replay",)),
}


def readme_sections() -> dict[str, str]:
    """Return the sections of the README by heading, without the headings. The lines before the first are ``""``."""
    text = (ROOT / "README.md").read_text()
    fences = [match.span() for match in FENCE.finditer(text)]
    marks = [
        match
        for match in re.finditer(r"^## (.+)\n", text, re.MULTILINE)
        if not any(begin <= match.start() < end for begin, end in fences)
    ]
    sections = {"": text[: marks[0].start()]}
    for mark, following in zip(marks, [*marks[1:], None], strict=True):
        sections[mark[1]] = text[mark.end() : following.start() if following else len(text)]
    return sections


def readme_page(page: Sections) -> str:
    """Return a page with some sections of the README. A single section has its heading as the title of the page.

    Raises:
        KeyError: The README has no section with one of the headings.
    """
    sections = readme_sections()
    head = f"# {page.title}\n" if page.title else sections[""]
    bodies = (
        sections[heading] if heading == page.title else f"## {heading}\n{sections[heading]}"
        for heading in page.headings
    )
    return "\n".join((head, *bodies))


def written_pages() -> dict[str, str]:
    """Return the pages that are made of the README and the other files of ``MOVED``, by their place in the site."""
    pages = {place: readme_page(page) for place, page in README_PAGES.items()}
    for source, place in MOVED.items():
        if place not in pages:
            pages[place] = (ROOT / source).read_text()
    return pages


def origin(place: str) -> str:
    """Return the path in the repository of the file from which the text of a page comes."""
    if place in README_PAGES:
        return "README.md"
    if place.startswith(f"{SOURCE_FILES}/"):
        return place.removeprefix(f"{SOURCE_FILES}/").removesuffix(".md")
    return next((source for source, moved in MOVED.items() if moved == place), f"docs/{place}")


def links(text: str) -> Iterator[str]:
    """Yield the targets of the links of a page, without those in examples."""
    yield from LINK.findall(FENCE.sub("", text))


def is_relative(link: str) -> bool:
    """Return True if a link leads to another file of the repository."""
    return not re.match(r"[a-z]+:|#|/", link)


def in_repository(link: str, file: str) -> str:
    """Return the path in the repository to which a relative link leads.

    Args:
        link: The link, without its anchor.
        file: The path in the repository of the file in which the link stands.
    """
    return posixpath.normpath(posixpath.join(posixpath.dirname(file), link))


def source_files(text: str, file: str) -> Iterator[str]:
    """Yield the paths of source files that a page links to: files of the repository that are no pages.

    Args:
        text: The text of the page.
        file: The path in the repository of the file from which the text comes.
    """
    for link in links(text):
        path = in_repository(link.partition("#")[0], file) if is_relative(link) else ""
        if path and not path.startswith(("docs/", "..")) and path not in MOVED and (ROOT / path).is_file():
            yield path


def source_page(path: str) -> str:
    """Return a page that shows a source file."""
    text = (ROOT / path).read_text()
    if Path(path).suffix == ".md":
        return text
    fence = "`" * (3 + max((len(ticks) for ticks in re.findall(r"`{3,}", text)), default=0))
    language = LANGUAGES.get(Path(path).suffix, "text")
    return f"# {path}\n\n{fence}{language}\n{text.rstrip()}\n{fence}\n"


def place_of(path: str) -> str:
    """Return the place in the site of a file of the repository."""
    if path in MOVED:
        return MOVED[path]
    if path.startswith("docs/"):
        return path.removeprefix("docs/")
    return f"{SOURCE_FILES}/{path}.md"


def relinked(text: str, place: str) -> str:
    """Return the text of a page with links that lead to the places of the site.

    Args:
        text: The text, with links relative to the file from which it comes.
        place: The place of the page in the site.
    """
    file = origin(place)

    def change(match: re.Match[str]) -> str:
        link = match[0]
        if not is_relative(link):
            return link
        target, sign, anchor = link.partition("#")
        path = in_repository(target, file)
        if not (ROOT / path).is_file():
            return link  # a page that is generated, or a link that MkDocs reports as broken
        moved = _section_place(anchor) if path == "README.md" else place_of(path)
        return posixpath.join(os.path.relpath(moved, posixpath.dirname(place) or ".")) + sign + anchor

    return outside_fences(text, lambda prose: LINK.sub(change, prose))


def _section_place(anchor: str) -> str:
    """Return the page that has the section of the README with this anchor."""
    for place, page in README_PAGES.items():
        if anchor in (heading.lower().replace("'", "").replace(" ", "-") for heading in page.headings):
            return place
    return "index.md"


def outside_fences(text: str, change: Callable[[str], str]) -> str:
    """Return a text in which ``change`` was applied to everything but the blocks of code."""
    parts: list[str] = []
    end = 0
    for fence in FENCE.finditer(text):
        parts += [change(text[end : fence.start()]), fence[0]]
        end = fence.end()
    return "".join((*parts, change(text[end:])))
