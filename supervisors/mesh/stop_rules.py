"""Reads a stop out of whatever it comes in. Pure.

A command that moves the robot has to be well formed. A stop has not: who sends ``"by": null``, a
field more or no ``turn_id`` means the robot to stop all the same, and hears too late that its form
was wrong. What is no command at all is a stop, too, when it says so in any other form
(``contract/stop_words.py``).
"""

from __future__ import annotations

from typing import Any

import msgspec

from strands_actors.contract.stop_words import asks_for_stop, names_estop

from .schemas import ACTIONS, MAX_TEXT, is_name

STOPS = {"stop": False, "estop": True}
"""By the action: whether it locks."""

_UNREADABLE = (msgspec.MsgspecError, UnicodeDecodeError, RecursionError)
_NOTHING = msgspec.Raw(b"null")


class _Around(msgspec.Struct):
    """Each field is read by itself: one that makes no sense spoils no other."""

    sender_id: msgspec.Raw = _NOTHING
    turn_id: msgspec.Raw = _NOTHING
    target_id: msgspec.Raw = _NOTHING
    action: msgspec.Raw = _NOTHING
    by: msgspec.Raw = _NOTHING
    command: msgspec.Raw = _NOTHING


class _Within(msgspec.Struct):
    action: msgspec.Raw = _NOTHING
    by: msgspec.Raw = _NOTHING


_decode_around = msgspec.json.Decoder(_Around).decode
_decode_within = msgspec.json.Decoder(_Within).decode
_decode_text = msgspec.json.Decoder(str).decode


class Said(msgspec.Struct, frozen=True):
    """What can be read of a payload; empty is what cannot. ``sender`` and ``turn`` are names."""

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
        """Return whether it is for this robot: unless it names another, it is."""
        return self.target in ("", "*", robot)


def read_loosely(payload: bytes, robot: str = "") -> Said:
    """Return what it says, whatever else is in it. The action is that of the command; where there is
    no command, it may stand beside the names."""
    around = _read(_decode_around, payload) or _Around()
    within = _read(_decode_within, around.command) or _Within(_text_or(around.command, around.action), around.by)
    return Said(
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
    """Return the command, where it is nothing but its action, or else the action beside it."""
    return command if _text(command) else action


def _text(raw: msgspec.Raw) -> str:
    text = _read(_decode_text, raw)
    return text if isinstance(text, str) else ""


def _name(raw: msgspec.Raw) -> str:
    name = _text(raw)
    return name if is_name(name) else ""
