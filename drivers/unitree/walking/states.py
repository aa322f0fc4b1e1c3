"""Encode and decode SportModeState, the state that an onboard controller publishes. No I/O, no clock.

A Go2 and a B2 report their mode and their estimated pose in it. A G1 reports only its pose. A frame is XCDR1,
little endian, without its four-byte encapsulation. The layout is from the IDL of ``unitree_sdk2``.
"""

from __future__ import annotations

import math
import struct
from typing import NamedTuple

from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.kernel.clock import NS

STATE_TOPIC = "rt/sportmodestate"
STATE_TYPE = "unitree_go::msg::dds_::SportModeState_"

# The fields are: time stamp, error code, IMU (13 floats, temperature), mode, progress, gait, height of a lifted
# foot, position, height of the body, velocity, turning speed. The following fields are not decoded: obstacles,
# feet, and ten points of a path.
_STATE = struct.Struct("<iII13fBB2xfB3xf3ff3ff")
STATE_BYTES = _STATE.size + 400


class SportState(NamedTuple):
    """A state of the onboard controller: its mode, and pose (in the odometry frame) and velocity of the robot."""

    stamp_ns: int  # Time of the state by the robot's clock.
    mode: int
    position: tuple[float, float, float]
    velocity: tuple[float, float, float]  # vx and vy in m/s and the turning speed in rad/s, in the body frame.
    orientation_wxyz: tuple[float, ...]
    height_m: float

    @property
    def has_pose(self) -> bool:
        """True if the robot has reported its pose and velocity. Otherwise they are NaN."""
        return math.isfinite(self.velocity[0])

    @property
    def heading_rad(self) -> float:
        w, x, y, z = self.orientation_wxyz
        return math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


def decode_state(body: bytes | memoryview) -> SportState:
    """Decode a SportModeState. Raise ``MalformedFrame`` if it is too short or a number is not finite."""
    if len(body) < _STATE.size:
        raise MalformedFrame(f"a SportModeState has {STATE_BYTES} bytes, not {len(body)}")
    flat = _STATE.unpack_from(body)
    orientation, (x, y, z), height, (vx, vy, _), turn = flat[3:7], flat[21:24], flat[24], flat[25:28], flat[28]
    if not all(map(math.isfinite, (*orientation, x, y, z, height, vx, vy, turn))):
        raise MalformedFrame("a SportModeState with a number that is not finite")
    return SportState(flat[0] * NS + flat[1], flat[17], (x, y, z), (vx, vy, turn), orientation, height)


def encode_state(state: SportState) -> bytes:
    """Encode a SportModeState. Only the simulated robot needs this."""
    vx, vy, turn = state.velocity
    stamp, nothing = divmod(state.stamp_ns, NS), (0.0,) * 9
    body = _STATE.pack(
        *stamp, 0, *state.orientation_wxyz, *nothing, 40, state.mode, 0.0, 0, 0.08, *state.position,
        state.height_m, vx, vy, 0.0, turn,
    )  # fmt: skip
    return body.ljust(STATE_BYTES, b"\0")
