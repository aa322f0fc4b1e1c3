"""Encode requests to a Spot and decode its replies. Pure: no clock, no socket.

Numbers of statuses and levels come from the published API, version 5.2.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from strands_actors.contract.rotations import roll_pitch_yaw
from strands_actors.drivers.common.codecs.malformed import MalformedFrame

from .messages import Message, decode, encode

PORT = 443
NS = 1_000_000_000

TWIST_S = 0.6
"""Every twist ends so long after it was sent, on the robot's clock, even if all our processes die."""

OK = 1
"""The status of success in most replies."""

LEASE_RESOURCE = "body"
ESTOP_ROLE = "PDB_rooted"
"""The role that every e-stop configuration must contain."""

BODY_FRAME, ODOM_FRAME = "body", "odom"
MOBILITY_PARAMS = "type.googleapis.com/bosdyn.api.spot.MobilityParams"
HINT_AUTO = 1

UINT64 = (1 << 64) - 1


class Method(NamedTuple):
    """One gRPC method. ``service`` is the name under which the robot's directory lists its service."""

    name: str
    service: str
    path: str
    request: str
    reply: str


def _methods(service: str, service_type: str, *names: str) -> dict[str, Method]:
    """Return the methods of a service. Each is given as ``name``, or as ``name:message`` if its
    messages have another name."""
    methods = {}
    for row in names:
        name, _, message = row.partition(":")
        message = message or name
        path = f"/bosdyn.api.{service_type}/{name}"
        methods[name] = Method(name, service, path, f"{message}Request", f"{message}Response")
    return methods


SERVICES: Mapping[str, str] = {
    "auth": "AuthService",
    "robot-id": "RobotIdService",
    "directory": "DirectoryService",
    "time-sync": "TimeSyncService",
    "estop": "EstopService",
    "lease": "LeaseService",
    "power": "PowerService",
    "robot-state": "RobotStateService",
    "robot-command": "RobotCommandService",
    "image": "ImageService",
    "data-buffer": "DataBufferService",
    "fault": "FaultService",
    "directory-registration": "DirectoryRegistrationService",
}
"""Type of each service, by its name in the directory."""

METHODS: Mapping[str, Method] = {
    **_methods("auth", SERVICES["auth"], "GetAuthToken"),
    **_methods("robot-id", SERVICES["robot-id"], "GetRobotId:RobotId"),
    **_methods("directory", SERVICES["directory"], "ListServiceEntries", "GetServiceEntry"),
    **_methods("time-sync", SERVICES["time-sync"], "TimeSyncUpdate"),
    **_methods(
        "estop",
        SERVICES["estop"],
        "EstopCheckIn",
        "RegisterEstopEndpoint",
        "DeregisterEstopEndpoint",
        "GetEstopConfig",
        "SetEstopConfig",
        "GetEstopSystemStatus",
    ),
    **_methods("lease", SERVICES["lease"], "AcquireLease", "TakeLease", "ReturnLease", "RetainLease", "ListLeases"),
    **_methods("power", SERVICES["power"], "PowerCommand", "PowerCommandFeedback"),
    **_methods(
        "robot-state",
        SERVICES["robot-state"],
        "GetRobotState:RobotState",
        "GetRobotMetrics:RobotMetrics",
        "GetRobotHardwareConfiguration:RobotHardwareConfiguration",
        "GetRobotLinkModel:RobotLinkModel",
    ),
    **_methods(
        "robot-command", SERVICES["robot-command"], "RobotCommand", "RobotCommandFeedback", "ClearBehaviorFault"
    ),
    **_methods("image", SERVICES["image"], "ListImageSources", "GetImage"),
    **_methods("data-buffer", SERVICES["data-buffer"], "RecordOperatorComments"),
    **_methods("fault", SERVICES["fault"], "TriggerServiceFault", "ClearServiceFault"),
    **_methods(
        "directory-registration",
        SERVICES["directory-registration"],
        "RegisterService",
        "UnregisterService",
        "UpdateService",
    ),
}

AUTHORITIES: Mapping[str, str] = {
    "auth": "auth.spot.robot",
    "robot-id": "id.spot.robot",
    "directory": "api.spot.robot",
}
"""Authorities of the services that are used before the directory was read."""


class StopLevel(enum.IntEnum):
    CUT = 1
    SETTLE_THEN_CUT = 2
    NONE = 4


class CheckIn(enum.IntEnum):
    OK = 1
    ENDPOINT_UNKNOWN = 2
    INCORRECT_CHALLENGE_RESPONSE = 5


class Motors(enum.IntEnum):
    UNKNOWN = 0
    OFF = 1
    ON = 2
    POWERING_ON = 3
    POWERING_OFF = 4
    ERROR = 5


class Power(enum.IntEnum):
    """Status of a request to switch the motors on or off."""

    UNKNOWN = 0
    IN_PROGRESS = 1
    SUCCESS = 2
    SHORE_POWER_CONNECTED = 3
    BATTERY_MISSING = 4
    COMMAND_IN_PROGRESS = 5
    ESTOPPED = 6
    FAULTED = 7
    INTERNAL_ERROR = 8
    LICENSE_ERROR = 9
    INCOMPATIBLE_HARDWARE = 10
    OVERRIDDEN = 11
    KEEPALIVE_MOTORS_OFF = 12


POWER_OFF, POWER_ON = 1, 2


class Command(enum.IntEnum):
    """Status that the robot returns for a command to move."""

    UNKNOWN = 0
    OK = 1
    INVALID_REQUEST = 2
    UNSUPPORTED = 3
    NO_TIMESYNC = 4
    EXPIRED = 5
    TOO_DISTANT = 6
    NOT_POWERED_ON = 7
    UNKNOWN_FRAME = 8
    BEHAVIOR_FAULT = 9
    DOCKED = 10


class LeaseUse(enum.IntEnum):
    UNKNOWN = 0
    OK = 1
    INVALID_LEASE = 2
    OLDER = 3
    REVOKED = 4
    UNMANAGED = 5
    WRONG_EPOCH = 6


LEASE_CLAIMED = 2
"""Status of an acquisition: another client has the lease."""

LOGIN_STATUS = {2: "user or password is wrong", 3: "the token is not valid", 4: "too many attempts, wait a while"}


def request(method: Method, body: Mapping[str, object], client: str, wall_ns: int) -> bytes:
    """Encode a request, with its header."""
    header = {"request_timestamp": stamp(wall_ns), "client_name": client}
    return encode(method.request, {"header": header, **body})


def reply(method: Method, data: bytes) -> Message:
    """Decode a reply. Raise ``MalformedFrame`` if its header reports an error."""
    message = decode(method.reply, data)
    error = message.get("header", {}).get("error", {})
    if error.get("code") != OK:
        raise MalformedFrame(f"{method.name}: error {error.get('code', 0)} {error.get('message', '')}".rstrip())
    return message


def name_of(status_type: type[enum.IntEnum], number: int) -> str:
    """Return a readable name for the number of a status."""
    try:
        return status_type(number).name.lower().replace("_", " ")
    except ValueError:
        return f"status {number}"


# -- time


def stamp(ns: int) -> Message:
    seconds, nanos = divmod(ns, NS)
    return {"seconds": seconds, "nanos": nanos}


def duration(seconds: float) -> Message:
    return stamp(round(seconds * NS))


def stamp_ns(message: Mapping[str, int]) -> int:
    """Convert a timestamp or a duration to nanoseconds."""
    return int(message.get("seconds", 0)) * NS + int(message.get("nanos", 0))


# -- leases


def newer_lease(lease: Message, count: int) -> Message:
    """Return the lease for its ``count``-th use. The robot refuses a use with a lower number than
    the highest that it has seen. A command that arrives late, after a stop, is thereby refused."""
    return {**lease, "sequence": [*lease.get("sequence", []), count]}


# -- commands


def twist(speeds: Sequence[float], end_ns: int) -> Message:
    """Return a command to walk with a twist that ends at ``end_ns`` on the robot's clock."""
    vx, vy, wz = speeds
    velocity = {
        "end_time": stamp(end_ns),
        "velocity": {"linear": {"x": vx, "y": vy}, "angular": wz},
        "se2_frame_name": BODY_FRAME,
    }
    return {"mobility_command": {"se2_velocity_request": velocity, "params": _params()}}


def stand() -> Message:
    return {"synchronized_command": {"mobility_command": {"stand_request": {}, "params": _params()}}}


def arm(positions_rad: Sequence[float], speed_rad_s: float) -> Message:
    names = ("sh0", "sh1", "el0", "el1", "wr0", "wr1")
    position = {name: {"value": value} for name, value in zip(names, positions_rad, strict=True)}
    trajectory = {"points": [{"position": position}], "maximum_velocity": {"value": speed_rad_s}}
    return {"arm_command": {"arm_joint_move_command": {"trajectory": trajectory}}}


def claw(position_rad: float) -> Message:
    return {"gripper_command": {"claw_gripper_command": {"trajectory": {"points": [{"point": position_rad}]}}}}


def together(*parts: Message) -> Message:
    """Combine commands for several parts of the body into one command."""
    return {"synchronized_command": {key: value for part in parts for key, value in part.items()}}


STOP: Message = {"full_body_command": {"stop_request": {}}}
SAFE_POWER_OFF: Message = {"full_body_command": {"safe_power_off_request": {"unsafe_action": 1}}}


def _params() -> Message:
    return {"type_url": MOBILITY_PARAMS, "value": {"locomotion_hint": HINT_AUTO}}


# -- e-stop


def challenge_response(challenge: int) -> int:
    """Return the answer to an e-stop challenge, the one's complement of its number. It proves that
    the challenge was received."""
    return challenge ^ UINT64


def endpoint_of(answer: Message, name: str) -> Message:
    """Return the endpoint with this name from an answer to ``GetEstopConfig``; empty if there is no
    such endpoint.

    Raises:
        MalformedFrame: The answer contains no configuration, so our endpoint may still be in force.
    """
    if "active_config" not in answer:
        raise MalformedFrame("GetEstopConfig: no configuration in its answer")
    return next(
        (endpoint for endpoint in answer["active_config"].get("endpoints", ()) if endpoint.get("name") == name), {}
    )


def body_owner(answer: Message) -> str:
    """Return the owner of the body's lease from an answer to ``ListLeases``; empty if there is no owner."""
    body: Message = next(
        (resource for resource in answer.get("resources", ()) if resource.get("resource") == LEASE_RESOURCE), {}
    )
    owner: str = body.get("lease_owner", {}).get("client_name", "")
    return owner


# -- decode the robot's state


Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]
"""w, x, y, z."""


class Reading(NamedTuple):
    """The robot's state. ``joints`` maps a joint's name in Spot's messages to position and
    velocity. A missing value is NaN, a value of zero is 0. ``pressed`` names the e-stops that are
    pressed."""

    motors: Motors
    pressed: tuple[str, ...]
    joints: Mapping[str, tuple[float, float]]
    battery_pct: float
    battery_v: float
    twist: Vector
    """Of the body, in its own frame: m/s and rad/s."""
    xyz_m: Vector
    quaternion: Quaternion
    """Of the body, in the frame of odometry."""
    faults: tuple[int, ...]
    """Ids of behaviour faults."""
    stamp_ns: int
    """Time of the state, on the robot's clock."""

    @property
    def rpy_rad(self) -> Vector:
        return roll_pitch_yaw(self.quaternion)

    @property
    def speed(self) -> float:
        """Return the speed of the body: the larger number of its linear (m/s) and angular (rad/s)
        speed."""
        vx, vy, wz = self.twist
        return max(math.hypot(vx, vy), abs(wz))


def reading(answer: Message) -> Reading:
    """Decode an answer to ``GetRobotState``. Raise ``MalformedFrame`` if a required field is
    missing."""
    state = answer.get("robot_state", {})
    motion = state.get("kinematic_state", {})
    battery: Message = next(iter(state.get("battery_states", ())), {})
    motors = state.get("power_state", {}).get("motor_power_state", 0)
    if motors not in tuple(Motors):
        raise MalformedFrame(f"robot state: motor power {motors}")
    joints = {
        entry.get("name", ""): (_number(entry, "position"), _number(entry, "velocity"))
        for entry in motion.get("joint_states", ())
    }
    xyz, quaternion = _body_in_odom(motion)
    return Reading(
        Motors(motors),
        tuple(entry.get("name", "?") for entry in state.get("estop_states", ()) if entry.get("state") == 1),
        joints,
        _number(battery, "charge_percentage"),
        _number(battery, "voltage"),
        _body_twist(motion.get("velocity_of_body_in_odom"), quaternion),
        xyz,
        quaternion,
        tuple(
            entry.get("behavior_fault_id", 0) for entry in state.get("behavior_fault_state", {}).get("faults", ())
        ),
        stamp_ns(motion.get("acquisition_timestamp", {})),
    )


def _number(message: Message, key: str) -> float:
    """Return the number in a protobuf wrapper message; NaN if it is missing or not finite. A zero
    arrives as an empty wrapper. A missing wrapper is an unknown value."""
    if key not in message:
        return math.nan
    value = float(message[key].get("value", 0.0))
    return value if math.isfinite(value) else math.nan


def _vector(message: Message) -> Vector:
    x, y, z = (float(message.get(axis, 0.0)) for axis in "xyz")
    return x, y, z


def _body_in_odom(motion: Message) -> tuple[Vector, Quaternion]:
    """Return position and rotation of the body in the odometry frame. The root of the robot's frame
    tree is the body, so the robot reports the inverse."""
    edges = {
        edge.get("key", ""): edge.get("value", {})
        for edge in motion.get("transforms_snapshot", {}).get("edges", ())
    }
    pose = edges.get(ODOM_FRAME, {}).get("parent_tform_child", {})
    x, y, z = _vector(pose.get("position", {}))
    rotation = pose.get("rotation", {})
    w, qx, qy, qz = (float(rotation.get(axis, 0.0)) for axis in "wxyz")
    norm = math.sqrt(w * w + qx * qx + qy * qy + qz * qz)
    if not math.isfinite(norm) or norm < 0.5:
        return (math.nan,) * 3, (math.nan,) * 4
    back = (w / norm, -qx / norm, -qy / norm, -qz / norm)
    rx, ry, rz = rotated(back, (x, y, z))
    return (-rx, -ry, -rz), back


def _body_twist(velocity: Message | None, quaternion: Quaternion) -> Vector:
    """Rotate a velocity from the odometry frame into the body frame. A missing velocity gives NaN,
    so that the robot does not seem to stand still."""
    if velocity is None:
        return math.nan, math.nan, math.nan
    linear, angular = _vector(velocity.get("linear", {})), _vector(velocity.get("angular", {}))
    w, x, y, z = quaternion
    vx, vy, _ = rotated((w, -x, -y, -z), linear)
    return vx, vy, angular[2]


def rotated(quaternion: Quaternion, vector: Vector) -> Vector:
    """Return a vector rotated by a unit quaternion (w, x, y, z)."""
    w, *axis = quaternion
    a, b, c = axis
    x, y, z = vector
    tx, ty, tz = 2 * (b * z - c * y), 2 * (c * x - a * z), 2 * (a * y - b * x)
    return x + w * tx + b * tz - c * ty, y + w * ty + c * tx - a * tz, z + w * tz + a * ty - b * tx
