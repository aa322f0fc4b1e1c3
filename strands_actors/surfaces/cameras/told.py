"""What a camera says of itself, beside its pictures: for ``get_status()`` and for who has none."""

from __future__ import annotations

import msgspec

WHY_LETTERS = 600
"""Of a reason: what is behind them is of no use to anybody."""


class Told(msgspec.Struct, frozen=True):
    """``state``: ``starting``, ``streaming``, or why there are no pictures: ``unavailable`` (it
    cannot be opened, or was unplugged), ``refused`` (it does not give what was asked for), ``down``
    (its process has ended)."""

    state: str = "starting"
    why: str = ""
    opened: int = 0  # how often its source was opened, by the present process
    fps: float = 0.0  # measured
    width: int = 0
    height: int = 0
    compressed: str = ""  # why there is no JPEG, where there is none


_encoder = msgspec.msgpack.Encoder()
_decoder = msgspec.msgpack.Decoder(Told)


def encode(told: Told) -> bytes:
    short = told if len(told.why) <= WHY_LETTERS else msgspec.structs.replace(told, why=told.why[:WHY_LETTERS])
    return _encoder.encode(short)


def decode(data: bytes) -> Told:
    """What cannot be read is a camera of which nothing is known."""
    try:
        return _decoder.decode(data)
    except msgspec.MsgspecError:
        return Told()
