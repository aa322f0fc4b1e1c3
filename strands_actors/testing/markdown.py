"""Format the prose of generated pages in the same way as that of the pages written by hand."""

from __future__ import annotations

import textwrap

COLUMNS = 100


def paragraph(text: str, indent: str = "") -> str:
    """Return one paragraph in lines of 100 columns. ``indent`` is put before its second and later lines."""
    words = " ".join(text.split())
    return textwrap.fill(words, COLUMNS, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False)
