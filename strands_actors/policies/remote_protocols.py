"""The two protocols of policy servers. Pure: each request has one response.

``Chunks``    ours: one request per chunk, msgpack or JSON. The client sends first.
``JsonV1``    that of strands-robots (version 1): JSON. The server sends first, ``ready``.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol

import msgspec

VERSION = 1
CODECS: dict[str, Any] = {"msgpack": msgspec.msgpack, "json": msgspec.json}


class Misunderstood(Exception):
    """A response that does not follow the protocol. The text has the reason."""


class Chunk(msgspec.Struct):
    """A response of our protocol."""

    actions: list[dict[str, float]] = []
    error: str = ""


class Facts(msgspec.Struct):
    """The properties of a policy, as a server of ``JsonV1`` reports them."""

    provider_name: str = "remote"
    requires_images: bool = False
    supports_rtc: bool = False
    execution_horizon: int = 1


class Ready(msgspec.Struct, tag="ready", tag_field="type"):
    """The greeting of ``JsonV1``."""

    protocol_version: int
    metadata: Facts = msgspec.field(default_factory=Facts)


class Ok(msgspec.Struct, tag="ok", tag_field="type"):
    """The response of ``JsonV1`` to an accepted setting, with the properties of the policy if they are sent."""

    metadata: Facts | None = None


class Actions(msgspec.Struct, tag="actions", tag_field="type"):
    """The response of ``JsonV1`` to a request for a chunk."""

    actions: list[dict[str, Any]]


class Failure(msgspec.Struct, tag="error", tag_field="type"):
    """The response of ``JsonV1`` to any request that failed, with the reason."""

    error: str


_ANSWER = msgspec.json.Decoder(Ready | Ok | Actions | Failure)


class Talk(Protocol):
    """One of the two protocols, with its state."""

    is_text: bool

    def tell(self, what: str, value: Any) -> bytes | None:
        """Return the message for a setting, which the server will answer.

        Args:
            what: ``keys``, ``hz`` or ``reset``.
            value: The names of the joints, the actions per second, or the seed.

        Returns:
            The encoded message; None if the next request carries the setting.
        """
        ...

    def request(self, observation: Mapping[str, float], instruction: str) -> bytes:
        """Return the request for a chunk."""
        ...

    def chunk(self, answer: bytes | str) -> list[dict[str, Any]]:
        """Return the actions of a response to it. Raise ``Misunderstood``."""
        ...


class Chunks:
    """Our protocol, which has no messages for settings: each request carries them.

    Args:
        encoding: ``msgpack`` or ``json``.
    """

    def __init__(self, encoding: str) -> None:
        self._codec = CODECS[encoding]
        self.is_text = encoding == "json"
        self._keys: list[str] = []
        self._hz = 0.0

    def tell(self, what: str, value: Any) -> None:
        """Keep a setting for the next requests. ``reset`` has no effect, since no request carries it."""
        if what == "keys":
            self._keys = list(value)
        elif what == "hz":
            self._hz = value

    def request(self, observation: Mapping[str, float], instruction: str) -> bytes:
        """Return the request for a chunk, with the names of the joints and the control rate (Hz)."""
        encoded: bytes = self._codec.encode(
            {"observation": dict(observation), "instruction": instruction, "axes": self._keys, "hz": self._hz}
        )
        return encoded

    def chunk(self, answer: bytes | str) -> list[dict[str, Any]]:
        """Return the actions of a response.

        Raises:
            Misunderstood: It is no chunk, or the server reports an error.
        """
        try:
            chunk: Chunk = self._codec.decode(answer, type=Chunk)
        except msgspec.DecodeError as error:
            raise Misunderstood(f"answered what is no chunk: {error}") from error
        if chunk.error:
            raise Misunderstood(f"says: {chunk.error}")
        return list(chunk.actions)


class JsonV1:
    """The protocol of strands-robots, version 1. Each setting is a message that the server answers.

    Args:
        facts: The properties of the policy, from the greeting. A later ``Ok`` may replace them.
    """

    is_text = True

    def __init__(self, facts: Facts) -> None:
        self.facts = facts

    def tell(self, what: str, value: Any) -> bytes:
        """Return the message for a setting. ``done`` reads the response to it."""
        named = {
            "keys": {"type": "set_state_keys", "keys": value},
            "hz": {"type": "set_control_frequency", "hz": value},
            "reset": {"type": "reset", "seed": value},
        }
        return msgspec.json.encode(named[what])

    def request(self, observation: Mapping[str, float], instruction: str) -> bytes:
        """Return the request for a chunk, ``get_actions``."""
        asked = {"observation": dict(observation), "instruction": instruction}
        return msgspec.json.encode({"type": "get_actions", **asked, "rtc_observed_delay_steps": None, "kwargs": {}})

    def done(self, answer: bytes | str) -> None:
        """Read the response to a setting. Raise ``Misunderstood`` if the server did not accept it."""
        response = _understood(answer)
        if not isinstance(response, Ok):
            raise Misunderstood(f"answered {type(response).__name__.lower()} where ok was due")
        if response.metadata is not None:
            self.facts = checked(response.metadata)

    def chunk(self, answer: bytes | str) -> list[dict[str, Any]]:
        """Return the actions of a response.

        Raises:
            Misunderstood: It has no actions, or the server reports an error.
        """
        found = _understood(answer)
        if not isinstance(found, Actions):
            raise Misunderstood(f"answered {type(found).__name__.lower()} where actions were due")
        return found.actions


def greeting(message: bytes | str) -> JsonV1 | None:
    """Return the protocol of a server that sent this greeting; None if the message is not a greeting.

    Raises:
        Misunderstood: The server has another version of the protocol, or reports a horizon below 1.
    """
    try:
        response = _ANSWER.decode(message)
    except msgspec.DecodeError:
        return None
    if not isinstance(response, Ready):
        return None
    if response.protocol_version != VERSION:
        raise Misunderstood(f"speaks version {response.protocol_version} of its protocol, not {VERSION}")
    return JsonV1(checked(response.metadata))


def checked(facts: Facts) -> Facts:
    """Return the server's description of its policy. Raise ``Misunderstood`` for a horizon below 1."""
    if facts.execution_horizon < 1:
        raise Misunderstood(f"advertises execution_horizon {facts.execution_horizon}. it is at least 1")
    return facts


def _understood(answer: bytes | str) -> Ready | Ok | Actions | Failure:
    try:
        response: Ready | Ok | Actions | Failure = _ANSWER.decode(answer)
    except msgspec.DecodeError as error:
        raise Misunderstood(f"answered what its protocol does not have: {error}") from error
    if isinstance(response, Failure):
        raise Misunderstood(f"says: {response.error}")
    return response
