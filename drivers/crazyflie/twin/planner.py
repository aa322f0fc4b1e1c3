"""Simulate the high-level commander: it plans flights, and flies them to their ends without a watchdog. No clock.

States of its planner:

    idle      no flight. Motors are off, unless setpoints of another commander fly the drone
    flying    a flight, and after its end a hover where it ended
    landing   a flight that ends in ``idle``
    disabled  a trajectory has a number that is not finite. No setpoint comes from it

A takeoff needs ``idle``. A landing needs any state but ``landing``. Other flights begin in any state. While the
supervisor lets no motor turn, every flight is refused.
"""

from __future__ import annotations

import enum
import math
import struct
from collections.abc import Callable, MutableMapping, Sequence
from typing import NamedTuple

from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.drivers.crazyflie.protocol import HighLevel

from . import packets
from .body import Target
from .trajectories import (
    Flight,
    Moment,
    Piece,
    Vector,
    compressed_pieces_in,
    piece_between,
    pieces_in,
    shortest_turn,
    spiral,
    straight,
)

DEFINITIONS = 10
"""Number of trajectories that can be defined."""
IN_MEMORY = 1
"""Location of a trajectory: in the memory for trajectories."""
UNCOMPRESSED, COMPRESSED = 0, 1
"""Types of trajectories."""
LONGEST_S = 60.0
"""Longest flight to a place [assumed]: a longer one is an error in the packet."""


class State(enum.IntEnum):
    IDLE = 0
    FLYING = 1
    LANDING = 2
    DISABLED = 3


class Definition(NamedTuple):
    """A trajectory in the memory."""

    type: int
    offset: int
    piece_count: int


class Planner:
    def __init__(self, parameters: MutableMapping[str, float], memory: bytearray) -> None:
        """Make a planner. ``parameters`` has the group ``hlCommander``, and ``memory`` the trajectories."""
        self._parameters = parameters
        self._memory = memory
        self._definitions: dict[int, Definition] = {}
        self.flight: Flight | None = None
        self._state = State.IDLE
        self._last: Moment | None = None  # the last moment of a flight that was finite

    # -- the present flight

    def state_at(self, now_s: float) -> State:
        """Return the state. A landing ends by itself."""
        if self._state is State.LANDING and self.flight is not None and now_s > self.flight.ends_s:
            self._state = State.IDLE
        return self._state

    def is_finished(self, now_s: float) -> bool:
        """Return True if the last flight has ended, or nothing has flown."""
        return self.flight is None or now_s >= self.flight.ends_s

    def moment(self, now_s: float) -> Moment | None:
        """Return where the flight has to be; None without a plan."""
        if self.state_at(now_s) not in (State.FLYING, State.LANDING) or self.flight is None:
            return None
        moment = self.flight.moment_at(now_s)
        if not all(map(math.isfinite, (*moment.xyz_m, *moment.velocity_m_s, moment.yaw_rad))):
            self._state = State.DISABLED
            return None
        self._last = moment
        return moment

    def target(self, now_s: float) -> Target | None:
        """Return the setpoint of the flight; None without a plan. A disabled commander leaves its last one."""
        moment = self.moment(now_s)
        if self._state is State.DISABLED:
            moment = self._last
        if moment is None:
            return None
        (x, y, z), (vx, vy, vz) = moment.xyz_m, moment.velocity_m_s
        return Target(vx, vy, vz, moment.yaw_rate_rad_s, z, xy_m=(x, y), yaw_rad=moment.yaw_rad)

    def stop(self) -> None:
        """End the flight. Motors are off."""
        self._state, self._last = State.IDLE, None

    # -- orders

    def obey(self, kind: int, data: bytes, estimate: Moment, now_s: float, blocked: bool) -> int:
        """Obey an order.

        Args:
            kind: A ``HighLevel``.
            data: The order without its first byte.
            estimate: Where the drone is.
            now_s: The present time.
            blocked: The supervisor lets no motor turn.

        Returns:
            The status of the answer: an error number, or 0.

        Raises:
            MalformedFrame: The order is no order.
            struct.error: The order has another length.
        """
        if not data:
            raise MalformedFrame("an order without data")
        match kind:
            case HighLevel.SET_GROUP_MASK:
                (self._parameters["hlCommander.groupmask"],) = struct.unpack("<B", data)
                return 0
            case HighLevel.DEFINE_TRAJECTORY:
                return self._define(*struct.unpack("<BBBIB", data))
            case HighLevel.STOP:
                if self._is_mine(data):
                    self.stop()
                return 0
        if blocked:
            return packets.EBUSY
        if not self._is_mine(data):
            # The firmware answers an order to another group with success, too.
            return 0
        start = self.moment(now_s) or estimate
        return _ORDERS[kind](self, data[1:], start, now_s)

    def _is_mine(self, data: bytes) -> bool:
        return data[0] == 0 or bool(data[0] & int(self._parameters["hlCommander.groupmask"]))

    def _define(self, number: int, location: int, kind: int, offset: int, count: int) -> int:
        if number >= DEFINITIONS:
            return packets.ENOEXEC
        self._definitions.pop(number, None)
        if location == IN_MEMORY:
            self._definitions[number] = Definition(kind, offset, count)
        return 0

    def _take_off_old(self, data: bytes, start: Moment, now_s: float) -> int:
        height_m, duration_s = _unpack("<ff", data)
        return self._rise(start, height_m, 0.0, duration_s, now_s)

    def _land_old(self, data: bytes, start: Moment, now_s: float) -> int:
        height_m, duration_s = _unpack("<ff", data)
        return self._sink(start, height_m, 0.0, duration_s, now_s)

    def _take_off(self, data: bytes, start: Moment, now_s: float) -> int:
        height_m, yaw_rad, keeps_yaw, duration_s = _unpack("<ff?f", data)
        return self._rise(start, height_m, start.yaw_rad if keeps_yaw else yaw_rad, duration_s, now_s)

    def _take_off_with_velocity(self, data: bytes, start: Moment, now_s: float) -> int:
        height_m, relative, yaw_rad, keeps_yaw, speed = _unpack("<f?f?f", data)
        to_m = start.xyz_m[2] + height_m if relative else height_m
        duration_s = abs(to_m - start.xyz_m[2]) / (speed if speed > 0 else self._parameters["hlCommander.vtoff"])
        return self._rise(start, to_m, start.yaw_rad if keeps_yaw else yaw_rad, duration_s, now_s)

    def _rise(self, start: Moment, height_m: float, yaw_rad: float, duration_s: float, now_s: float) -> int:
        if self.state_at(now_s) is not State.IDLE:
            return packets.EPERM
        return self._begin(_vertical(start, height_m, yaw_rad, duration_s), now_s)

    def _land(self, data: bytes, start: Moment, now_s: float) -> int:
        height_m, yaw_rad, keeps_yaw, duration_s = _unpack("<ff?f", data)
        return self._sink(start, height_m, start.yaw_rad if keeps_yaw else yaw_rad, duration_s, now_s)

    def _land_with_velocity(self, data: bytes, start: Moment, now_s: float) -> int:
        height_m, relative, yaw_rad, keeps_yaw, speed = _unpack("<f?f?f", data)
        to_m = start.xyz_m[2] - height_m if relative else height_m
        duration_s = abs(to_m - start.xyz_m[2]) / (speed if speed > 0 else self._parameters["hlCommander.vland"])
        return self._sink(start, to_m, start.yaw_rad if keeps_yaw else yaw_rad, duration_s, now_s)

    def _sink(self, start: Moment, height_m: float, yaw_rad: float, duration_s: float, now_s: float) -> int:
        if self.state_at(now_s) is State.LANDING:
            return packets.EPERM
        return self._begin(_vertical(start, height_m, yaw_rad, duration_s), now_s, State.LANDING)

    def land(self, start: Moment, duration_s: float, now_s: float) -> None:
        """Land on the floor, in the place of a client."""
        self._begin(_vertical(start, 0.0, start.yaw_rad, duration_s), now_s, State.LANDING)

    def _go_to(self, data: bytes, start: Moment, now_s: float) -> int:
        relative, *place = _unpack("<?5f", data)
        return self._go(start, bool(relative), False, place, now_s)

    def _go_to_2(self, data: bytes, start: Moment, now_s: float) -> int:
        relative, linear, *place = _unpack("<??5f", data)
        return self._go(start, bool(relative), bool(linear), place, now_s)

    def _go(self, start: Moment, relative: bool, linear: bool, place: Sequence[float], now_s: float) -> int:
        x, y, z, yaw_rad, duration_s = place
        if relative:
            x, y, z = x + start.xyz_m[0], y + start.xyz_m[1], z + start.xyz_m[2]
            yaw_rad += start.yaw_rad
        yaw_rad = start.yaw_rad + shortest_turn(start.yaw_rad, yaw_rad)
        duration_s = _duration(duration_s)
        if linear:
            return self._begin(straight(start, (x, y, z), yaw_rad, duration_s), now_s)
        return self._begin(piece_between(start, Moment((x, y, z), yaw_rad), duration_s), now_s)

    def _spiral(self, data: bytes, start: Moment, now_s: float) -> int:
        sideways, clockwise, angle_rad, first_m, last_m, ascent_m, duration_s = _unpack("<??5f", data)
        if duration_s <= 0:
            raise MalformedFrame("a spiral without a duration")
        style = int(sideways) | int(clockwise) << 1
        piece = spiral(start, angle_rad, (first_m, last_m), ascent_m, _duration(duration_s), style)
        return self._begin(piece, now_s)

    def _start_trajectory(self, data: bytes, start: Moment, now_s: float) -> int:
        relative, reverse, number, time_scale = _unpack("<??Bf", data)
        return self._start(number, time_scale, bool(reverse), start.xyz_m if relative else None, None, now_s)

    def _start_trajectory_2(self, data: bytes, start: Moment, now_s: float) -> int:
        relative, turned, reverse, number, time_scale = _unpack("<???Bf", data)
        place, yaw_rad = start.xyz_m if relative else None, start.yaw_rad if turned else None
        return self._start(number, time_scale, bool(reverse), place, yaw_rad, now_s)

    def _start(
        self,
        number: float,
        time_scale: float,
        reverse: bool,
        place: Vector | None,
        yaw_rad: float | None,
        now_s: float,
    ) -> int:
        definition = self._definitions.get(int(number))
        if definition is None or definition.type not in (UNCOMPRESSED, COMPRESSED):
            # The firmware answers success, and nothing flies.
            return 0
        if definition.type == COMPRESSED:
            if time_scale != 1 or reverse:
                return packets.ENOEXEC
            pieces = compressed_pieces_in(self._memory, definition.offset)
            yaw_rad = None
        else:
            pieces = pieces_in(self._memory, definition.offset, definition.piece_count)
        if not pieces:
            raise MalformedFrame("a trajectory without a piece")
        flight = Flight(pieces, now_s, time_scale, reverse)
        if place is not None:
            flight.shift_to(place, yaw_rad)
        self.flight, self._state = flight, State.FLYING
        return 0

    def _begin(self, piece: Piece, now_s: float, state: State = State.FLYING) -> int:
        self.flight, self._state = Flight((piece,), now_s), state
        return 0


Order = Callable[[Planner, bytes, Moment, float], int]
_ORDERS: dict[int, Order] = {
    HighLevel.OLD_TAKEOFF: Planner._take_off_old,
    HighLevel.OLD_LAND: Planner._land_old,
    HighLevel.GO_TO: Planner._go_to,
    HighLevel.START_TRAJECTORY: Planner._start_trajectory,
    HighLevel.TAKEOFF: Planner._take_off,
    HighLevel.LAND: Planner._land,
    HighLevel.TAKEOFF_WITH_VELOCITY: Planner._take_off_with_velocity,
    HighLevel.LAND_WITH_VELOCITY: Planner._land_with_velocity,
    HighLevel.SPIRAL: Planner._spiral,
    HighLevel.GO_TO_2: Planner._go_to_2,
    HighLevel.START_TRAJECTORY_2: Planner._start_trajectory_2,
}
"""The orders that begin a flight."""


def _vertical(start: Moment, height_m: float, yaw_rad: float, duration_s: float) -> Piece:
    """Plan a takeoff or a landing: straight up or down, from rest to rest."""
    x, y, z = start.xyz_m
    end_yaw = start.yaw_rad + shortest_turn(start.yaw_rad, yaw_rad)
    rest = Moment((x, y, z), start.yaw_rad)
    return piece_between(rest, Moment((x, y, height_m), end_yaw), _duration(duration_s))


def _duration(duration_s: float) -> float:
    if not 0 <= duration_s < LONGEST_S:
        raise MalformedFrame(f"a flight of {duration_s} s")
    return duration_s


def _unpack(layout: str, data: bytes) -> tuple[float, ...]:
    values = struct.unpack(layout, data)
    if not all(map(math.isfinite, values)):
        raise MalformedFrame("an order with a number that is not finite")
    return values


__all__ = ["Planner", "State"]
