"""Find a stop in any message. Pure.

A command that moves the robot must be well formed. A stop need not be. A sender of ``"by": null``, of an unknown
field or of no ``turn_id`` still wants the robot to stop, and after a refusal the next stop would come too late. A
message that is not a command also counts as a stop if it asks for one in other words (``contract/stop_words.py``).
"""

from __future__ import annotations

from typing import Any

import msgspec

from strands_actors.contract.stop_words import asks_for_stop, names_estop

from .schemas import ACTIONS, MAX_TEXT, is_name

STOPS = {"stop": False, "estop": True}
"""The actions that stop, and whether each one locks the robot."""

_UNREADABLE = (msgspec.MsgspecError, UnicodeDecodeError, RecursionError)
_NOTHING = msgspec.Raw(b"null")


class _Around(msgspec.Struct):
    """The outer fields of a message. Each field is decoded separately, so that the others can be read if one is
    invalid."""

    sender_id: msgspec.Raw = _NOTHING
    turn_id: msgspec.Raw = _NOTHING
    target_id: msgspec.Raw = _NOTHING
    action: msgspec.Raw = _NOTHING
    by: msgspec.Raw = _NOTHING
    command: msgspec.Raw = _NOTHING


class _Within(msgspec.Struct):
    """The fields of the command within a message."""

    action: msgspec.Raw = _NOTHING
    by: msgspec.Raw = _NOTHING


_decode_around = msgspec.json.Decoder(_Around).decode
_decode_within = msgspec.json.Decoder(_Within).decode
_decode_text = msgspec.json.Decoder(str).decode


class MessageOutline(msgspec.Struct, frozen=True):
    """The fields of a message that could be read. The others are empty. ``sender`` and ``turn`` are valid names or
    empty."""

    sender: str = ""
    turn: str = ""
    target: str = ""
    action: str = ""
    by: str = ""

    @property
    def stops(self) -> bool:
        return self.action in STOPS

    @property
    def locks(self) -> bool:
        return STOPS.get(self.action, False)

    def means(self, robot: str) -> bool:
        """Return True unless the message names another robot."""
        return self.target in ("", "*", robot)


def read_loosely(payload: bytes, robot: str = "") -> MessageOutline:
    """Return the fields of a message that can be read, and ignore the rest. Never raises.

    Args:
        payload: The message. Its action is in ``command``, or else in the outer fields.
        robot: Name of this robot. A text that asks for a stop may contain it.
    """
    around = _read(_decode_around, payload) or _Around()
    within = _read(_decode_within, around.command) or _Within(_text_or(around.command, around.action), around.by)
    return MessageOutline(
        _name(around.sender_id),
        _name(around.turn_id),
        _text(around.target_id),
        _action(within.action, payload, robot),
        _text(within.by)[:MAX_TEXT],
    )


def _action(raw: msgspec.Raw, payload: bytes, robot: str) -> str:
    action = _text(raw).strip().lower()
    if action in STOPS or action in ACTIONS or not asks_for_stop(payload, robot):
        return action
    return "estop" if names_estop(payload.decode("utf-8", "replace")) else "stop"


def _read(decode: Any, data: bytes | msgspec.Raw) -> Any:
    try:
        return decode(data)
    except _UNREADABLE:
        return None


def _text_or(command: msgspec.Raw, action: msgspec.Raw) -> msgspec.Raw:
    """Return ``command`` if it is a text, since that is then the action. Otherwise return ``action``."""
    return command if _text(command) else action


def _text(raw: msgspec.Raw) -> str:
    text = _read(_decode_text, raw)
    return text if isinstance(text, str) else ""


def _name(raw: msgspec.Raw) -> str:
    name = _text(raw)
    return name if is_name(name) else ""
