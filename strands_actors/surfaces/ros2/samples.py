"""The fields that this surface reads from the JSON of a robot's topics. Unknown fields are ignored."""

from __future__ import annotations

from typing import Any

import msgspec

from strands_actors.kernel.channels.pubsub import Received
from strands_actors.supervisors.mesh.schemas import camera_topic

Numbers = list[float | None]
CAMERA = camera_topic("")


class Presence(msgspec.Struct, frozen=True):
    """The topic ``presence``."""

    hw: str
    action_keys: tuple[str, ...] = ()
    connected: bool = False
    state: str = ""
    epoch: int = 0
    locked_by: str = ""
    lease: str = ""
    topics: tuple[str, ...] = ()

    @property
    def cameras(self) -> list[str]:
        """Return the names of the cameras."""
        return [topic.removeprefix(CAMERA) for topic in self.topics if topic.startswith(CAMERA)]


class State(msgspec.Struct, frozen=True):
    """The topic ``state``. ``t`` is the time of sending in seconds, and ``age_s`` the age of the reading."""

    t: float
    joints: dict[str, Any] = {}
    velocities: dict[str, Any] = {}
    age_s: float | None = None
    efforts: dict[str, Any] = {}


class Health(msgspec.Struct, frozen=True):
    """The topic ``health``."""

    ok: bool = False
    cause: str = ""
    last_stop_cause: str = ""
    connect_error: str = ""
    faults: dict[str, str] = {}
    refusals: int = 0
    last_refusal: str = ""


class Imu(msgspec.Struct, frozen=True):
    """The topic ``imu``: radians, radians per second, metres per second squared."""

    t: float
    rpy: Numbers | None = None
    quaternion: Numbers | None = None
    gyro: Numbers | None = None
    accel: Numbers | None = None


class Battery(msgspec.Struct, frozen=True):
    """The topic ``battery``: percent, volts."""

    t: float
    pct: float | None = None
    voltage: float | None = None


class Odom(msgspec.Struct, frozen=True):
    """The topic ``odom``: metres, radians, and speeds in the robot's own frame."""

    t: float
    xy: Numbers | None = None
    xyz: Numbers | None = None
    quaternion: Numbers | None = None
    theta: float | None = None
    yaw: float | None = None
    heading: float | None = None
    linear: Numbers | float | None = None
    angular: Numbers | float | None = None


class Wrench(msgspec.Struct, frozen=True):
    """The topic ``wrench``: three forces in newtons and three torques in newton metres.

    They are those at the tool, along the axes of ``frame``.
    """

    t: float
    wrench: Numbers | None = None
    frame: str = "base"


Sample = Presence | State | Health | Imu | Battery | Odom | Wrench
TOPICS: dict[str, type[Sample]] = {
    "presence": Presence,
    "state": State,
    "health": Health,
    "imu": Imu,
    "battery": Battery,
    "odom": Odom,
    "wrench": Wrench,
}
"""The type of each topic that is read."""


def read_sample(received: Received) -> tuple[str, Sample] | None:
    """Return the robot's name and the content of a sample. None for a sample that cannot be read."""
    parts = received.key.split("/")
    sample_type = TOPICS.get(parts[-1])
    if len(parts) != 3 or sample_type is None:
        return None
    try:
        return parts[1], msgspec.json.decode(received.payload, type=sample_type)
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError):
        return None
