"""The limits of the simulated controller: those of the arm, its reduced mode, and its safety boundary.

In the reduced mode joints and tool are slower, and joints have smaller ranges. The safety boundary is a box that
the tool must not leave. Both are lost when the controller restarts [assumed: unless a client has saved them].
"""

from __future__ import annotations

import struct
from collections.abc import Sequence

from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.drivers.xarm import protocol as p
from strands_actors.drivers.xarm.arms import ArmType

from .registers import Other

TOP_MM_S = 1000.0
"""Highest speed of the tool, in mm/s."""

FAR_MM = 5000
"""A side of the boundary that no client has set is out of reach [assumed]."""

TOLERANCE_RAD = 1e-3


class Limits:
    """The limits of one arm."""

    def __init__(self, arm_type: ArmType, top_rad_s: float) -> None:
        """Args:
        arm_type: The type of the arm, which has the joint ranges.
        top_rad_s: Highest speed of a joint.
        """
        self._arm_type = arm_type
        self._own_rad_s = top_rad_s
        self.reset()

    def reset(self) -> None:
        """Switch the reduced mode and the boundary off, and forget their settings."""
        self.reduced = self.fence = False
        self._reduced_mm_s, self._reduced_rad_s = TOP_MM_S, self._own_rad_s
        self._reduced_range_rad = list(self._arm_type.range_rad)
        # Highest and lowest x, y and z in mm.
        self._boundary_mm = [FAR_MM, -FAR_MM] * 3

    @property
    def top_rad_s(self) -> float:
        return min(self._own_rad_s, self._reduced_rad_s) if self.reduced else self._own_rad_s

    @property
    def top_mm_s(self) -> float:
        return min(TOP_MM_S, self._reduced_mm_s) if self.reduced else TOP_MM_S

    def accepts(self, rad: Sequence[float]) -> bool:
        """Return True if each joint is in its range."""
        ranges = self._reduced_range_rad if self.reduced else self._arm_type.range_rad
        return all(
            low - TOLERANCE_RAD <= each <= high + TOLERANCE_RAD
            for each, (low, high) in zip(rad, ranges, strict=True)
        )

    def contains(self, mm: Sequence[float]) -> bool:
        """Return True if the tool may be at x, y, z."""
        highest, lowest = self._boundary_mm[::2], self._boundary_mm[1::2]
        rows = zip(lowest, mm, highest, strict=True)
        return not self.fence or all(low <= each <= high for low, each, high in rows)

    def obey(self, register: int, data: bytes) -> bytes:
        """Carry out a request, and return the data of the reply. Raise ``MalformedFrame`` or ``IndexError`` if the
        request is invalid."""
        match register:
            case Other.REDUCED_MM_S:
                self._reduced_mm_s = _positive(data)
            case Other.REDUCED_RAD_S:
                self._reduced_rad_s = _positive(data)
            case Other.REDUCED_RANGE:
                numbers = p.unpack_floats(data, 2 * p.JOINTS)
                pairs = list(zip(numbers[::2], numbers[1::2], strict=True))
                if not all(-1e3 < low < high < 1e3 for low, high in pairs):
                    raise MalformedFrame(f"ranges {pairs}")
                self._reduced_range_rad = pairs
            case Other.BOUNDARY if len(data) >= 24:
                sides = list(struct.unpack_from("<6i", data))
                if not all(
                    -FAR_MM <= low <= high <= FAR_MM for high, low in zip(sides[::2], sides[1::2], strict=True)
                ):
                    raise MalformedFrame(f"boundary {sides}")
                self._boundary_mm = sides
            case Other.SET_REDUCED if data[0] in (0, 1):
                self.reduced = bool(data[0])
            case Other.SET_FENCE if data[0] in (0, 1):
                self.fence = bool(data[0])
            case Other.GET_REDUCED:
                return bytes((self.reduced,))
            case Other.REDUCED_STATE:
                return self._state()
            case _:
                raise MalformedFrame(f"register {register} with {data.hex()}")
        return b""

    def _state(self) -> bytes:
        """Return all settings. The last byte is the rebound after a collision, which the twin does not have."""
        speeds = p.floats((self._reduced_mm_s, self._reduced_rad_s))
        ranges = p.floats([end for ends in self._reduced_range_rad for end in ends])
        return struct.pack(">B6h", self.reduced, *self._boundary_mm) + speeds + ranges + bytes((self.fence, 0))


def _positive(data: bytes) -> float:
    (number,) = p.unpack_floats(data, 1)
    if not 0.0 < number < 1e6:
        raise MalformedFrame(f"speed {number}")
    return number
