"""Prose of the pages that are generated, in the columns of those that are written by hand."""

from __future__ import annotations

import textwrap

COLUMNS = 100


def paragraph(text: str, indent: str = "") -> str:
    """Return one paragraph in lines of 100 columns. ``indent``: of its second line and those
    after."""
    words = " ".join(text.split())
    return textwrap.fill(words, COLUMNS, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False)
