"""The users who may open a session with the simulated base."""

from __future__ import annotations

from typing import NamedTuple

from strands_actors.drivers.common.codecs import protobuf as pb
from strands_actors.drivers.kinova.protocol import Login, SubError

from . import messages as m
from .errors import CallFailed, ProtocolFailed
from .stores import Changed, Store

HANDLE_FIELD = 9


class User(NamedTuple):
    name: str
    password: str


class Users:
    def __init__(self, own: User, changed: Changed) -> None:
        self._store: Store[User] = Store(HANDLE_FIELD, changed)
        self._store.reset({1: own})

    def check(self, login: Login) -> None:
        """Raise ``ProtocolFailed`` if the user or the password is wrong."""
        user = next((user for _, user in self._store.items() if user.name == login.username), None)
        if user is None:
            raise ProtocolFailed(SubError.USER_NOT_FOUND)
        if user.password != login.password:
            raise ProtocolFailed(SubError.INVALID_PASSWORD)

    def create(self, payload: bytes) -> bytes:
        """Add the user of a ``FullUserProfile``, and return the handle."""
        fields = pb.message(payload)
        name = m.text(m.sub_message(fields, 1), 2)
        if not name:
            raise CallFailed(SubError.USERNAME_EMPTY, "the user has no name")
        if any(user.name == name for _, user in self._store.items()):
            raise CallFailed(SubError.USERNAME_ALREADY_EXISTS, f"there is a user {name}")
        return m.Handle(self._store.add(User(name, m.text(fields, 2)))).encode()

    def delete(self, payload: bytes) -> bytes:
        self._store.delete(m.identifier_of(payload))
        return b""
