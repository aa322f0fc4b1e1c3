"""What others have sent, as a message may show it: short, in bounded time, and harmless to a
terminal. Pure."""

from __future__ import annotations

import difflib
import reprlib
from collections.abc import Iterable

LONGEST = 100
"""Characters of a name that are compared with others."""


def shown(value: object, most: int = 40) -> str:
    """Return a value in ``most`` characters, whatever it is, however deep and however long."""
    brief = reprlib.Repr()
    brief.maxlevel, brief.maxdict, brief.maxlist, brief.maxtuple, brief.maxset = 3, 4, 6, 6, 6
    brief.maxstring = brief.maxother = brief.maxlong = most
    try:
        text = repr(value[:most]) if isinstance(value, str | bytes) else brief.repr(value)
    except (ValueError, RecursionError):  # a number of too many digits, an object that shows itself so
        text = f"<{type(value).__name__}>"
    return harmless(text)[:most]


def harmless(text: str) -> str:
    """As it is, but what moves a cursor, colours, hides, turns the direction of a line or is no
    character at all is written out."""
    if text.isprintable():
        return text
    return "".join(each if each.isprintable() else ascii(each)[1:-1] for each in text)


def closest(name: object, known: Iterable[str], count: int = 1) -> list[str]:
    """Return what may have been meant. A name that is too long to be one is like none."""
    text = name if isinstance(name, str) else ""
    return difflib.get_close_matches(text, list(known), n=count) if len(text) <= LONGEST else []
