"""Draw docstrings, comments, messages and sentences of the pages for a reader who does not know the project.

``python -m tests.house.samples [SEED]`` prints fifty of each, with their places. The reader explains each
one. At least 47 of each fifty should be right at the first reading.
"""

from __future__ import annotations

import ast
import functools
import io
import random
import re
import sys
import textwrap
import tokenize
from collections.abc import Iterator
from pathlib import Path

from strands_actors.kernel.messages import sentence_case

from .plain_words import files
from .test_imports import ROOT
from .test_refusals import PASSED_ON, assignments, shown

COUNT = 50
SEED = 20261129
WORDS = 4
"""Shorter texts are left out."""

FENCES = re.compile(r"^```.*?^```$", re.DOTALL | re.MULTILINE)
LINK_TARGET = re.compile(r"\]\([^)\s]*\)")
TO_TOOLS = re.compile(r"noqa|type: ignore|fmt: ")
SENTENCE = re.compile(r"(?<=[.!?])\s+(?=[A-Z`*])")
MESSAGES = {"Refused", "ValueError", "TypeError", "WireDown", "RuntimeError", "DatasetError"}
"""Calls that carry a message to the user."""


def docstrings(path: Path, tree: ast.Module) -> Iterator[str]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            text = ast.get_docstring(node)
            if text:
                name = "" if isinstance(node, ast.Module) else f" {node.name}"
                yield f"{path}{name}: {text}"


def comments(path: Path, source: str) -> Iterator[str]:
    """Yield each block of comment lines as one text. A comment behind code stands for itself."""
    block: list[str] = []
    last_line = 0
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type != tokenize.COMMENT or TO_TOOLS.search(token.string):
            continue
        line = token.start[0]
        if not token.line.lstrip().startswith("#"):
            yield f"{path}:{line}: {token.line.strip()}"
            continue
        if block and line != last_line + 1:
            yield f"{path}:{last_line}: {' '.join(block)}"
            block = []
        block.append(token.string.lstrip("# "))
        last_line = line
    if block:
        yield f"{path}:{last_line}: {' '.join(block)}"


def messages(path: Path, tree: ast.Module) -> Iterator[str]:
    """Yield each message with the names of values in braces. Of a refusal it is the reason and the remedy."""
    for function in ast.walk(tree):
        if not isinstance(function, ast.FunctionDef | ast.AsyncFunctionDef):
            continue
        assigned = dict(assignments(function))
        for node in ast.walk(function):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in MESSAGES:
                given = node.args[1:3] if node.func.id == "Refused" else node.args
                first, *others = (shown(each, assigned) for each in given) if given else ("",)
                text = ". ".join((first, *map(sentence_case, others)))
                if not PASSED_ON.fullmatch(text):
                    yield f"{path}:{node.lineno}: {text}"


def sentences(path: Path, page: str) -> Iterator[str]:
    text = LINK_TARGET.sub("]", FENCES.sub("", page))
    prose = "\n".join(line for line in text.splitlines() if not line.startswith(("#", "|", "!")))
    for paragraph in prose.split("\n\n"):
        for sentence in SENTENCE.split(" ".join(paragraph.split())):
            yield f"{path}: {sentence}"


@functools.cache
def texts() -> dict[str, list[str]]:
    """Return all texts of each kind that are long enough."""
    found: dict[str, list[str]] = {"docstrings": [], "comments": [], "messages": [], "sentences": []}
    for file in files():
        path, source = file.relative_to(ROOT), file.read_text()
        if file.suffix == ".md":
            found["sentences"] += sentences(path, source)
            continue
        tree = ast.parse(source)
        found["docstrings"] += docstrings(path, tree)
        found["comments"] += comments(path, source)
        found["messages"] += messages(path, tree)
    return {kind: [text for text in all_of_it if len(text.split()) > WORDS] for kind, all_of_it in found.items()}


def drawn(seed: int = SEED) -> dict[str, list[str]]:
    """Return ``COUNT`` texts of each kind. The same seed draws the same places of the same source."""
    chosen = random.Random(seed)
    return {kind: chosen.sample(all_of_it, COUNT) for kind, all_of_it in texts().items()}


def main() -> None:
    for kind, chosen in drawn(int(sys.argv[1]) if sys.argv[1:] else SEED).items():
        print(f"\n# {kind}\n")
        for number, text in enumerate(chosen, 1):
            print(textwrap.indent(f"{number}. {text}", "   ").lstrip() + "\n")


if __name__ == "__main__":
    main()
