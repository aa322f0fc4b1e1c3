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

from .build import ROOT

LINK = re.compile(r'(?<=\]\()([^)\s]+)(?=\))|(?<= src=")([^"]+)(?=")')
"""The target of a link or picture in Markdown, or the file of an HTML picture."""
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


def written_pages() -> dict[str, str]:
    """Return the pages that are files of ``MOVED``, by their place in the site."""
    return {place: (ROOT / source).read_text() for source, place in MOVED.items()}


def origin(place: str) -> str:
    """Return the path in the repository of the file from which the text of a page comes."""
    if place.startswith(f"{SOURCE_FILES}/"):
        return place.removeprefix(f"{SOURCE_FILES}/").removesuffix(".md")
    return next((source for source, moved in MOVED.items() if moved == place), f"docs/{place}")


def links(text: str) -> Iterator[str]:
    """Yield the targets of the links of a page, without those in examples."""
    yield from (link[0] for link in LINK.finditer(FENCE.sub("", text)))


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
        return posixpath.join(os.path.relpath(place_of(path), posixpath.dirname(place) or ".")) + sign + anchor

    return outside_fences(text, lambda prose: LINK.sub(change, prose))


def outside_fences(text: str, change: Callable[[str], str]) -> str:
    """Return a text in which ``change`` was applied to everything but the blocks of code."""
    parts: list[str] = []
    end = 0
    for fence in FENCE.finditer(text):
        parts += [change(text[end : fence.start()]), fence[0]]
        end = fence.end()
    return "".join((*parts, change(text[end:])))
