"""The two protocols of policy servers. Pure: each request has one response.

``Chunks``    the protocol of this package: one request per chunk of actions, msgpack or JSON. The client sends
              the first message.
``JsonV1``    the protocol of strands-robots (version 1): JSON. The server sends the first message, ``ready``.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol

import msgspec

from strands_actors.contract.shown import harmless

from .remote_errors import Misunderstood

VERSION = 1
CODECS: dict[str, Any] = {"msgpack": msgspec.msgpack, "json": msgspec.json}


class Chunk(msgspec.Struct):
    """The response in the protocol of this package: a chunk of actions, or an error."""

    actions: list[dict[str, float]] = []
    error: str = ""


class Facts(msgspec.Struct):
    """The properties of a policy, as a server with the protocol ``JsonV1`` reports them."""

    provider_name: str = "remote"
    requires_images: bool = False
    supports_rtc: bool = False
    execution_horizon: int = 1


class Ready(msgspec.Struct, tag="ready", tag_field="type"):
    """The greeting in the protocol ``JsonV1``."""

    protocol_version: int
    metadata: Facts = msgspec.field(default_factory=Facts)


class Ok(msgspec.Struct, tag="ok", tag_field="type"):
    """The response in the protocol ``JsonV1`` to a setting that the server accepts.

    It may have the policy's properties.
    """

    metadata: Facts | None = None


class Actions(msgspec.Struct, tag="actions", tag_field="type"):
    """The response in the protocol ``JsonV1`` to a request for a chunk."""

    actions: list[dict[str, Any]]


class Failure(msgspec.Struct, tag="error", tag_field="type"):
    """The response in the protocol ``JsonV1`` to any request that failed, with the reason."""

    error: str


_ANSWER = msgspec.json.Decoder(Ready | Ok | Actions | Failure)


class Talk(Protocol):
    """Encodes requests and decodes responses in one of the two protocols."""

    is_text: bool

    def apply_setting(self, setting: str, value: Any) -> bytes | None:
        """Return the message that sends a setting to the server. The server will answer it.

        Args:
            setting: ``keys``, ``hz`` or ``reset``.
            value: The names of the joints, the actions per second, or the seed.

        Returns:
            The encoded message; None if the setting is part of the next request instead.
        """
        ...

    def request(self, observation: Mapping[str, float], instruction: str) -> bytes:
        """Return the request for a chunk of actions."""
        ...

    def chunk(self, answer: bytes | str) -> list[dict[str, Any]]:
        """Return the actions in the response to a request. Raise ``Misunderstood`` if there are no actions."""
        ...


class Chunks:
    """The protocol of this package. It has no messages for settings: each request contains all settings.

    Args:
        encoding: ``msgpack`` or ``json``.
    """

    def __init__(self, encoding: str) -> None:
        self._codec = CODECS[encoding]
        self.is_text = encoding == "json"
        self._keys: list[str] = []
        self._hz = 0.0

    def apply_setting(self, setting: str, value: Any) -> None:
        """Store a setting, which the next requests contain.

        ``reset`` has no effect, since requests do not contain it.
        """
        if setting == "keys":
            self._keys = list(value)
        elif setting == "hz":
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
            Misunderstood: The response is not a chunk, or the server reports an error.
        """
        if isinstance(answer, str) and not self.is_text:
            raise Misunderstood(f"sent a text instead of a chunk of actions: {harmless(answer[-200:])}")
        try:
            chunk: Chunk = self._codec.decode(answer, type=Chunk)
        except msgspec.DecodeError as error:
            raise Misunderstood(f"sent a response that is not a chunk of actions: {error}") from error
        if chunk.error:
            raise Misunderstood(f"reports an error: {chunk.error}")
        return list(chunk.actions)


class JsonV1:
    """The protocol of strands-robots, version 1. Each setting is a message that the server answers.

    Args:
        facts: The properties of the policy, from the greeting. A later ``Ok`` may replace them.
    """

    is_text = True

    def __init__(self, facts: Facts) -> None:
        self.facts = facts

    def apply_setting(self, setting: str, value: Any) -> bytes:
        """Return the message that sends a setting to the server.

        The method ``done`` reads the server's response.
        """
        named = {
            "keys": {"type": "set_state_keys", "keys": value},
            "hz": {"type": "set_control_frequency", "hz": value},
            "reset": {"type": "reset", "seed": value},
        }
        return msgspec.json.encode(named[setting])

    def request(self, observation: Mapping[str, float], instruction: str) -> bytes:
        """Return the request for a chunk, ``get_actions``."""
        fields = {"observation": dict(observation), "instruction": instruction}
        return msgspec.json.encode(
            {"type": "get_actions", **fields, "rtc_observed_delay_steps": None, "kwargs": {}}
        )

    def done(self, answer: bytes | str) -> None:
        """Read the server's response to a setting. Raise ``Misunderstood`` if the server did not accept it."""
        response = _understood(answer)
        if not isinstance(response, Ok):
            raise Misunderstood(f"answered {type(response).__name__.lower()} instead of ok")
        if response.metadata is not None:
            self.facts = checked(response.metadata)

    def chunk(self, answer: bytes | str) -> list[dict[str, Any]]:
        """Return the actions of a response.

        Raises:
            Misunderstood: The response has no actions, or the server reports an error.
        """
        response = _understood(answer)
        if not isinstance(response, Actions):
            raise Misunderstood(f"answered {type(response).__name__.lower()} instead of actions")
        return response.actions


def greeting(message: bytes | str) -> JsonV1 | None:
    """Return the protocol of a server that sent this greeting; None if the message is not a greeting.

    Raises:
        Misunderstood: The server has another version of the protocol, or reports an execution horizon (executed
            actions of a chunk) below 1.
    """
    try:
        response = _ANSWER.decode(message)
    except msgspec.DecodeError:
        return None
    if not isinstance(response, Ready):
        return None
    if response.protocol_version != VERSION:
        raise Misunderstood(f"uses version {response.protocol_version} of its protocol, not {VERSION}")
    return JsonV1(checked(response.metadata))


def checked(facts: Facts) -> Facts:
    """Return the server's description of its policy. Raise ``Misunderstood`` for an execution horizon below 1."""
    if facts.execution_horizon < 1:
        raise Misunderstood(f"reports execution_horizon {facts.execution_horizon}, which must be at least 1")
    return facts


def _understood(answer: bytes | str) -> Ready | Ok | Actions | Failure:
    try:
        response: Ready | Ok | Actions | Failure = _ANSWER.decode(answer)
    except msgspec.DecodeError as error:
        raise Misunderstood(f"sent a response that its protocol does not have: {error}") from error
    if isinstance(response, Failure):
        raise Misunderstood(f"reports an error: {response.error}")
    return response
