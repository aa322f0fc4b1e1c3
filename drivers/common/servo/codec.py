"""The interface of a servo protocol. The ``protocol`` module of each servo family implements ``Codec``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Protocol

from strands_actors.drivers.common.ports.half_duplex import Decoder, PacketT_co


class Field(Protocol):
    """One register of a servo: its address and size, and how its value is decoded."""

    @property
    def address(self) -> int: ...
    @property
    def size(self) -> int: ...
    def decode(self, data: bytes, base: int | None = None) -> int:
        """Return the value of this register in a block of registers.

        Args:
            data: The bytes of the block.
            base: The address of the block's first register. The default is the address of this register.
        """
        ...


class Codec(Protocol[PacketT_co]):
    """Constants of a servo protocol, and functions that make its frames."""

    @property
    def BROADCAST(self) -> int: ...
    @property
    def OVERHEAD(self) -> int:
        """Bytes of a reply without parameters."""
        ...

    @property
    def LIMP(self) -> bytes:
        """Frame that switches off the torque of every servo."""
        ...

    @property
    def RESYNC(self) -> bytes:
        """Bytes that bring a servo's parser back to its start, if an incomplete header was received before."""
        ...

    @property
    def TORQUE_ENABLE(self) -> Field: ...
    @property
    def GOAL_POSITION(self) -> Field: ...
    @property
    def POSITION(self) -> Field: ...
    @property
    def TORQUE_LIMIT(self) -> Field:
        """The register that limits the torque of a servo until its power is switched off."""
        ...

    @property
    def EFFORT(self) -> Field:
        """The register with the power that a servo gives its motor, ``FULL_EFFORT`` at most."""
        ...

    @property
    def FULL_EFFORT(self) -> int: ...
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
        """Return one frame with the goal positions of all servos, in counts by id."""
        ...

    def hold(self, positions: Mapping[int, int]) -> bytes:
        """Return one frame that sets the goals to the measured positions, in counts by id. Its bytes differ from
        those of a setpoint, so that a log can distinguish both."""
        ...

    def lower(self, goals: Mapping[int, int], torque_limits: Mapping[int, int]) -> bytes:
        """Return the bytes that set goals and torque limits while an arm is lowered, by id. They differ from those
        of a setpoint and of a hold, so that a log can distinguish them."""
        ...

    def full_torque(self, torque_limits: Mapping[int, int]) -> bytes:
        """Return one frame that undoes what ``lower`` has limited. It moves nothing, and energises nothing."""
        ...
