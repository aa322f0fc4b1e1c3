"""State as data which messages of its robot's protocol a simulated robot models.

A simulated robot (twin) looks up each message in such a table first. A message outside the table gets the vendor's
own error, or silence where the real robot is silent, and never a success. The command ``strands-actors twin NAME
--about`` and the robot's page show the tables.
"""

from __future__ import annotations

import enum
from collections.abc import Iterator, Mapping
from importlib import import_module
from typing import Generic, NamedTuple, TypeVar

Key = TypeVar("Key", int, str)


class Row(NamedTuple):
    """One modelled message: its number or name in the protocol, and its effect in a few words."""

    message: str
    effect: str


class Modelled(Generic[Key]):
    """The messages of one kind that a simulated robot models."""

    def __init__(
        self, title: str, effects: Mapping[Key, str], otherwise: str, robots: frozenset[str] = frozenset()
    ) -> None:
        """Make a table.

        Args:
            title: The kind of the messages, such as "registers of the control port".
            effects: The effect of each message in a few words, by the message's number or name.
            otherwise: The answer to every other message.
            robots: The table is for these robots. Empty: for all robots of the wire.
        """
        self.title = title
        self.effects: Mapping[Key, str] = effects
        self.otherwise = otherwise
        self.robots = robots

    def __contains__(self, key: Key) -> bool:
        return key in self.effects

    def rows(self) -> Iterator[Row]:
        """Yield the modelled messages: by their numbers, or by their names in the order of the table."""
        keys = list(self.effects)
        if all(isinstance(key, int) for key in keys):
            keys.sort()
        for key in keys:
            yield Row(_text_of(key), self.effects[key])


def tables_of(twin: str, robot: str) -> tuple[Modelled[int] | Modelled[str], ...]:
    """Return the tables of one robot's twin. A twin without a protocol has no table.

    Args:
        twin: The twin's function as text, ``module:name``, as in ``Driver.TWIN``.
        robot: The robot's name.
    """
    tables = getattr(import_module(twin.partition(":")[0]), "MODELLED", ())
    return tuple(table for table in tables if not table.robots or robot in table.robots)


def _text_of(key: int | str) -> str:
    if isinstance(key, enum.IntEnum):
        return f"{key.value} {key.name}"
    return str(key)


__all__ = ["Modelled", "Row", "tables_of"]
