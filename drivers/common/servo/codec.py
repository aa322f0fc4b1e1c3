"""The protocol that the shared code needs. The ``protocol`` module of each wire is a ``Codec``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Protocol

from strands_actors.drivers.common.ports.half_duplex import Decoder, PacketT_co


class Field(Protocol):
    """A register, as a reader sees it."""

    @property
    def address(self) -> int: ...
    @property
    def size(self) -> int: ...
    def decode(self, data: bytes, base: int | None = None) -> int:
        """Return the value in a block of registers.

        Args:
            data: The block.
            base: Its address. The default is the address of this register.
        """
        ...


class Codec(Protocol[PacketT_co]):
    """Constants of a protocol, and functions that make its frames."""

    @property
    def BROADCAST(self) -> int: ...
    @property
    def OVERHEAD(self) -> int:
        """Bytes of a reply without params."""
        ...

    @property
    def LIMP(self) -> bytes:
        """Frame that switches off the torque of every servo."""
        ...

    @property
    def RESYNC(self) -> bytes:
        """Bytes after which a parser that is inside a torn header starts again."""
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
        """Return one frame with the goals of all servos, counts by id."""
        ...

    def hold(self, positions: Mapping[int, int]) -> bytes:
        """Return one frame that sets the goals to the measured positions, counts by id. The log can tell it
        from a setpoint."""
        ...
