"""Entities that clients store in the base, by their numbers: users, actions, sequences and protection zones."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Generic, TypeVar

from strands_actors.drivers.common.codecs import protobuf as pb
from strands_actors.drivers.kinova.protocol import SubError

from .errors import CallFailed

Entity = TypeVar("Entity")

CREATED, DELETED = 4, 2
"""``ConfigurationNotificationEvent`` of the vendor."""

FIRST_CREATED = 10_000
"""Number of the first entity that a client creates, as in the vendor's simulator."""

Changed = Callable[[int, int, int], None]
"""Called after a change: with the event, the field of the handle in the notification, and the number."""


class Store(Generic[Entity]):
    def __init__(self, handle_field: int, changed: Changed) -> None:
        """Args:
        handle_field: Field of the handle in ``ConfigurationChangeNotification``.
        changed: Called after a client has created or deleted an entity.
        """
        self._entities: dict[int, Entity] = {}
        self._own: frozenset[int] = frozenset()
        self._handle_field = handle_field
        self._changed = changed

    def reset(self, own: dict[int, Entity]) -> None:
        """Keep only the base's own entities, which clients cannot delete."""
        self._entities, self._own = dict(own), frozenset(own)

    def add(self, entity: Entity) -> int:
        """Store an entity, and return its number."""
        number = max(self._entities, default=0) + 1
        number = max(number, FIRST_CREATED)
        self._entities[number] = entity
        self._changed(CREATED, self._handle_field, number)
        return number

    def get(self, number: int) -> Entity:
        try:
            return self._entities[number]
        except KeyError:
            raise CallFailed(SubError.ENTITY_NOT_FOUND, f"nothing has the number {number}") from None

    def delete(self, number: int) -> None:
        self.get(number)
        if number in self._own:
            raise CallFailed(SubError.DELETE_PERMISSION_DENIED, f"{number} belongs to the base")
        del self._entities[number]
        self._changed(DELETED, self._handle_field, number)

    def items(self) -> Iterator[tuple[int, Entity]]:
        yield from self._entities.items()

    def encode_all(self, encode: Callable[[int, Entity], bytes]) -> bytes:
        """Return a message with all entities in its field 1."""
        return b"".join(pb.bytes_field(1, encode(number, entity)) for number, entity in self.items())
