"""What the shared code needs of a protocol: the ``protocol`` module of each wire is a ``Codec``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Protocol

from strands_actors.drivers.common.half_duplex import Decoder, PacketT_co


class Field(Protocol):
    """A register, to a reader."""

    @property
    def address(self) -> int: ...
    @property
    def size(self) -> int: ...
    def decode(self, data: bytes, base: int | None = None) -> int:
        """Return the value in ``data``, a block read from address ``base`` (default: the register's
        own)."""
        ...


class Codec(Protocol[PacketT_co]):
    """Constants, and functions that make frames."""

    @property
    def BROADCAST(self) -> int: ...
    @property
    def OVERHEAD(self) -> int:
        """Return the bytes of a reply that has no params."""
        ...

    @property
    def LIMP(self) -> bytes:
        """Torque off on every servo."""
        ...

    @property
    def RESYNC(self) -> bytes:
        """Makes a parser that is inside a torn header begin anew."""
        ...

    @property
    def TORQUE_ENABLE(self) -> Field: ...
    @property
    def GOAL_POSITION(self) -> Field: ...
    @property
    def POSITION(self) -> Field: ...
    @property
    def BAUD_RATES(self) -> Sequence[int]: ...
    @property
    def MODEL_NUMBERS(self) -> Mapping[int, str]: ...
    def Decoder(self) -> Decoder[PacketT_co]: ...
    def ping(self, servo_id: int) -> bytes: ...
    def read(self, servo_id: int, address: int, size: int) -> bytes: ...
    def sync_read(self, ids: Sequence[int], address: int, size: int) -> bytes: ...
    def torque(self, servo_id: int, on: bool) -> bytes: ...
    def goals(self, counts: Mapping[int, int]) -> bytes:
        """One setpoint for all."""
        ...

    def hold(self, positions: Mapping[int, int]) -> bytes:
        """Goals := the measured positions, in a frame that the log can tell from a setpoint."""
        ...
