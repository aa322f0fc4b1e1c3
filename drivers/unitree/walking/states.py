"""SportModeState: the mode and the estimated pose of the onboard controller of a Go2 or a B2; for a G1 the
pose only. No I/O, no clock.

XCDR1, little endian, without its four-byte encapsulation. Layout: the IDL of ``unitree_sdk2``.
"""

from __future__ import annotations

import math
import struct
from typing import NamedTuple

from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.kernel.clock import NS

STATE_TOPIC = "rt/sportmodestate"
STATE_TYPE = "unitree_go::msg::dds_::SportModeState_"

# Stamp, error code, imu (13 floats, temperature), mode, progress, gait, height of a lifted foot, position, height
# of the body, velocity, speed of the turn. Skipped after them: obstacles, feet and ten points of a path.
_STATE = struct.Struct("<iII13fBB2xfB3xf3ff3ff")
STATE_BYTES = _STATE.size + 400


class SportState(NamedTuple):
    """A state, in metres and radians in the frame of the odometry. Velocities are in the frame of the body."""

    stamp_ns: int  # by the robot's clock
    mode: int
    position: tuple[float, float, float]
    velocity: tuple[float, float, float]  # vx, vy in m/s, and the turn about z in rad/s
    orientation_wxyz: tuple[float, ...]
    height_m: float

    @property
    def has_pose(self) -> bool:
        """Return True if the pose and the velocity are known."""
        return math.isfinite(self.velocity[0])

    @property
    def heading_rad(self) -> float:
        w, x, y, z = self.orientation_wxyz
        return math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


def decode_state(body: bytes | memoryview) -> SportState:
    """Return the state of a frame. Raise ``MalformedFrame`` if it is too short or a number is not finite."""
    if len(body) < _STATE.size:
        raise MalformedFrame(f"a SportModeState has {STATE_BYTES} bytes, not {len(body)}")
    flat = _STATE.unpack_from(body)
    orientation, (x, y, z), height, (vx, vy, _), turn = flat[3:7], flat[21:24], flat[24], flat[25:28], flat[28]
    if not all(map(math.isfinite, (*orientation, x, y, z, height, vx, vy, turn))):
        raise MalformedFrame("a SportModeState with a number that is not finite")
    return SportState(flat[0] * NS + flat[1], flat[17], (x, y, z), (vx, vy, turn), orientation, height)


def encode_state(state: SportState) -> bytes:
    """Return the frame of a state, for twins."""
    vx, vy, turn = state.velocity
    stamp, nothing = divmod(state.stamp_ns, NS), (0.0,) * 9
    body = _STATE.pack(
        *stamp, 0, *state.orientation_wxyz, *nothing, 40, state.mode, 0.0, 0, 0.08, *state.position,
        state.height_m, vx, vy, 0.0, turn,
    )  # fmt: skip
    return body.ljust(STATE_BYTES, b"\0")
