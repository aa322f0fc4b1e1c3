"""Show received values in messages.

The result is short, is made in bounded time, and cannot harm a terminal. Pure.
"""

from __future__ import annotations

import difflib
import reprlib
from collections.abc import Iterable

SHOWN = 40
"""The longest text of a key or value in a refusal, in characters."""
LONGEST = 100
"""The longest name that is compared with others."""


def shown(value: object, most: int = SHOWN) -> str:
    """Return a value as text of at most ``most`` characters, even if it is deeply nested or very long."""
    brief = reprlib.Repr()
    brief.maxlevel, brief.maxdict, brief.maxlist, brief.maxtuple, brief.maxset = 3, 4, 6, 6, 6
    brief.maxstring = brief.maxother = brief.maxlong = most
    try:
        text = repr(value[:most]) if isinstance(value, str | bytes) else brief.repr(value)
    # The number has too many digits to be converted, or the object's ``repr`` fails.
    except (ValueError, RecursionError):
        text = f"<{type(value).__name__}>"
    return harmless(text)[:most]


def harmless(text: str) -> str:
    """Return a text in which only printable characters are left.

    All others are escaped: characters that move the cursor, change colours, hide text or change its direction, and
    invalid ones.
    """
    if text.isprintable():
        return text
    return "".join(each if each.isprintable() else ascii(each)[1:-1] for each in text)


def closest(name: object, names: Iterable[str], count: int = 1) -> list[str]:
    """Return the known names that are most similar to a name. A name that is too long gets no suggestions."""
    text = name if isinstance(name, str) else ""
    return difflib.get_close_matches(text, list(names), n=count) if len(text) <= LONGEST else []
