"""Count the marks of a private style in docstrings, comments and pages.

A mark is a word that stands for a person or a thing without naming it ("who is not heard", "what was
told"), or a word that engineers do not use for machines. Plain technical text has less than one in a
thousand words.

``python -m tests.house.plain_words FILE_OR_FOLDER ...`` prints each mark with its line.
"""

from __future__ import annotations

import ast
import io
import re
import sys
import tokenize
from collections.abc import Iterable, Iterator
from math import ceil
from pathlib import Path
from typing import NamedTuple

from .test_imports import ROOT

FOLDERS = ("strands_actors", "supervisors", "drivers", "benchmarks", "examples", "plugins")
MARKS_PER_WORD = 3 / 1000

MARKS = re.compile(
    r"\b(?:[Ww]ho|[Ww]hoever|[Ww]hom)\b(?! (?:is|are|has|was|had) (?:the|a)\b)"
    r"|\b[Ww]hose\b|\b[Nn]obody\b|\b[Ss]omebody\b|\b[Ww]hatever\b|\bnone\b"
    r"|\b[Ww]hat (?:is|was|it|they|a|the|has|who|became|goes|came|cannot|can|may|made|must|nobody|one|follows|says"
    r"|said|reads|runs|waits|leads)\b"
    r"|\bshall\b|\bbeside\b|\bof then\b|\bthe one before\b|\bas it (?:has|is)\b|\bof (?:its|their) own\b"
    r"|\b(?:told|tells|said|says)\b|\bis to\b"
    r"|\w+: (?:none|nobody|not|it|all|as|what|who|else)\b"
)
CODE = re.compile(r"```.*?```|``[^`]*``|`[^`]*`|<!--.*?-->|\]\([^)\s]*\)", re.DOTALL)
"""Neither code nor the targets of links are prose."""


class Text(NamedTuple):
    """A piece of prose."""

    line: int
    words: str


def prose_of_python(source: str) -> Iterator[Text]:
    """Yield docstrings, the strings below constants, and comments."""
    for node in ast.walk(ast.parse(source)):
        if (
            isinstance(node, ast.Expr)
            and isinstance(node.value, ast.Constant)
            and isinstance(node.value.value, str)
        ):
            yield Text(node.lineno, CODE.sub(" ", node.value.value))
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type == tokenize.COMMENT:
            yield Text(token.start[0], CODE.sub(" ", token.string))


def prose_of_page(source: str) -> Iterator[Text]:
    yield Text(1, CODE.sub(lambda code: "\n" * code[0].count("\n") + " ", source))


def prose_of(path: Path) -> list[Text]:
    source = path.read_text()
    return list(prose_of_python(source) if path.suffix == ".py" else prose_of_page(source))


def word_count(texts: Iterable[Text]) -> int:
    return sum(len(re.findall(r"[A-Za-z']+", text.words)) for text in texts)


def marks_of(texts: Iterable[Text]) -> Iterator[tuple[int, str]]:
    """Yield the line of each mark and the words around it."""
    for text in texts:
        for mark in MARKS.finditer(text.words):
            before = text.words[: mark.start()]
            around = text.words[max(0, mark.start() - 30) : mark.end() + 30]
            yield text.line + before.count("\n"), " ".join(around.split())


def allowed(words: int) -> int:
    """Return how many marks a file of so many words may have. One is always allowed."""
    return max(1, ceil(MARKS_PER_WORD * words))


def pages() -> list[Path]:
    return sorted((*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")))


def files() -> list[Path]:
    """Return the sources and pages, without the environments that some commands make in hidden folders.
    ``strands_actors`` has links to folders beside it: each file stands once."""
    sources = (path for folder in FOLDERS for path in (ROOT / folder).rglob("*.py"))
    shown = (path for path in sources if not any(part.startswith(".") for part in path.relative_to(ROOT).parts))
    return sorted({path.resolve() for path in (*shown, *pages())})


def too_many() -> dict[str, int]:
    """Return the files with more marks than allowed, with the number of their marks."""
    counts = {}
    for path in files():
        texts = prose_of(path)
        count = len(list(marks_of(texts)))
        if count > allowed(word_count(texts)):
            counts[str(path.relative_to(ROOT))] = count
    return counts


def main(arguments: list[str]) -> None:
    for given in map(Path, arguments):
        for path in sorted(given.rglob("*.py")) if given.is_dir() else [given]:
            texts = prose_of(path)
            marks = list(marks_of(texts))
            print(f"{path}: {len(marks)} marks, {allowed(word_count(texts))} allowed")
            for line, around in marks:
                print(f"  {line}: {around}")


if __name__ == "__main__":
    main(sys.argv[1:])
