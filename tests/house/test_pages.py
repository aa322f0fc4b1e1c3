"""The targets of the pages' links exist, and so do the files and tests that the pages name."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from .plain_words import pages
from .test_imports import PACKAGE, ROOT

PAGES = pages()
FENCES = re.compile(r"^```.*?^```$", re.DOTALL | re.MULTILINE)
LINK = re.compile(r"\]\(([^)\s]+)\)")
TEST = re.compile(r"`(test_\w+)`")
FILES = (
    re.compile(
        r"(?<![\w./<-])((?:tests|supervisors|drivers|strands_actors|benchmarks|examples|kernel|contract|policies)"
        r"/[\w/.-]+\.(?:py|toml|md|html))"
    ),
    re.compile(r"`(tests/[\w/.-]+)`"),
)
"""Files of this project and folders of tests."""


def prose(page: Path) -> str:
    return FENCES.sub("", page.read_text())


def anchors(page: Path) -> set[str]:
    """Return the anchors that GitHub makes from the headings."""
    headings = re.findall(r"^#+ (.+)$", prose(page), re.MULTILINE)
    plain = [re.sub(r"[^\w\- ]", "", LINK.sub("]", heading).lower()) for heading in headings]
    return {heading.strip().replace(" ", "-") for heading in plain}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_lead_to_files_and_headings_that_exist(page: Path) -> None:
    broken = []
    for link in LINK.findall(prose(page)):
        if "://" in link or link.startswith("mailto:"):
            continue
        name, _, anchor = link.partition("#")
        target = (page.parent / name).resolve() if name else page
        if not target.exists() or (anchor and target.suffix == ".md" and anchor not in anchors(target)):
            broken.append(link)
    assert not broken


def test_the_files_that_the_pages_name_exist() -> None:
    missing = [
        f"{page.relative_to(ROOT)}: {name}"
        for page in PAGES
        for files in FILES
        for name in files.findall(page.read_text())
        if not (ROOT / name).exists() and not (ROOT / PACKAGE / name).exists()
    ]
    assert missing == []


def test_every_test_that_a_page_names_exists() -> None:
    there: set[str] = set()
    for path in ROOT.glob("tests/**/test_*.py"):
        there |= {path.stem, *re.findall(r"def (test_\w+)", path.read_text())}
    missing = {page.name: named for page in PAGES if (named := set(TEST.findall(page.read_text())) - there)}
    assert missing == {}
