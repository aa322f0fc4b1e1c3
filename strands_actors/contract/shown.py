"""Show received values in messages: short, in bounded time, and harmless to a terminal. Pure."""

from __future__ import annotations

import difflib
import reprlib
from collections.abc import Iterable

LONGEST = 100
"""The longest name that is compared with others."""


def shown(value: object, most: int = 40) -> str:
    """Return a value in at most ``most`` characters, however deep and long it is."""
    brief = reprlib.Repr()
    brief.maxlevel, brief.maxdict, brief.maxlist, brief.maxtuple, brief.maxset = 3, 4, 6, 6, 6
    brief.maxstring = brief.maxother = brief.maxlong = most
    try:
        text = repr(value[:most]) if isinstance(value, str | bytes) else brief.repr(value)
    # A number has too many digits, or the object's repr fails.
    except (ValueError, RecursionError):
        text = f"<{type(value).__name__}>"
    return harmless(text)[:most]


def harmless(text: str) -> str:
    """Return a text in which only printable characters are left.

    Others are escaped: those that move a cursor, colour, hide, change the direction of a line, or are no
    character at all.
    """
    if text.isprintable():
        return text
    return "".join(each if each.isprintable() else ascii(each)[1:-1] for each in text)


def closest(name: object, known: Iterable[str], count: int = 1) -> list[str]:
    """Return the most similar known names. A name that is too long matches none of them."""
    text = name if isinstance(name, str) else ""
    return difflib.get_close_matches(text, list(known), n=count) if len(text) <= LONGEST else []
