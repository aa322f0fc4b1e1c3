"""Encode and decode the messages of an RB-Y1's gRPC server, except commands and states: paths,
enums and small messages. Pure: no I/O.

Field numbers and enums are from the vendor's public definitions (package ``rb.api``, Apache-2.0),
as in rby1-sdk 0.10.0.
"""

from __future__ import annotations

import enum
from collections.abc import Iterator

import msgspec

from strands_actors.drivers.common.codecs import protobuf as pb
from strands_actors.drivers.common.codecs.malformed import MalformedFrame

PORT = 50051
ALL = ".*"
"""Selects every supply or every joint. The server takes names as regular expressions."""
MOTOR_SUPPLY = "48v"

_CODE_OK = 1
_CODE_INVALID_REQUEST = 3
_NS = 1_000_000_000


class Method(enum.StrEnum):
    """Paths of the gRPC calls that this driver or its simulated robot uses."""

    PING = "/rb.api.PingService/Ping"
    GET_ROBOT_INFO = "/rb.api.RobotInfoService/GetRobotInfo"
    GET_ROBOT_MODEL = "/rb.api.RobotInfoService/GetRobotModel"
    GET_ROBOT_STATE = "/rb.api.RobotStateService/GetRobotState"
    IMPORT_ROBOT_MODEL = "/rb.api.RobotInfoService/ImportRobotModel"
    STATE_STREAM = "/rb.api.RobotStateService/GetRobotStateStream"
    RESET_ODOMETRY = "/rb.api.RobotStateService/ResetOdometry"
    GET_MANAGER_STATE = "/rb.api.RobotStateService/GetControlManagerState"
    POWER = "/rb.api.PowerService/PowerCommand"
    JOINT = "/rb.api.PowerService/JointCommand"
    SERVO_ON = "/rb.api.JointOperationService/ServoOn"
    SERVO_OFF = "/rb.api.JointOperationService/ServoOff"
    GET_GAINS = "/rb.api.JointOperationService/GetPositionPIDGain"
    SET_GAINS = "/rb.api.JointOperationService/SetPositionPIDGain"
    FLANGE_POWER = "/rb.api.PowerService/ToolFlangePowerCommand"
    FLANGE_OUTPUT = "/rb.api.ToolFlangeService/SetDigitalOutput"
    MANAGER = "/rb.api.ControlManagerService/ControlManagerCommand"
    CANCEL = "/rb.api.ControlManagerService/CancelControl"
    GET_TIME_SCALE = "/rb.api.ControlManagerService/GetTimeScale"
    SET_TIME_SCALE = "/rb.api.ControlManagerService/SetTimeScale"
    WAIT_READY = "/rb.api.ControlManagerService/WaitForControlReady"
    COMMAND = "/rb.api.RobotCommandService/RobotCommand"
    COMMAND_STREAM = "/rb.api.RobotCommandService/RobotCommandStream"
    GET_PARAMETERS = "/rb.api.ParameterService/GetParameterList"
    GET_PARAMETER = "/rb.api.ParameterService/GetParameter"
    SET_PARAMETER = "/rb.api.ParameterService/SetParameter"
    RESET_PARAMETER = "/rb.api.ParameterService/ResetParameter"
    RESET_PARAMETERS = "/rb.api.ParameterService/ResetAllParameters"
    FACTORY_PARAMETER = "/rb.api.ParameterService/FactoryResetParameter"
    FACTORY_PARAMETERS = "/rb.api.ParameterService/FactoryResetAllParameters"
    DEFAULT_PARAMETER = "/rb.api.ParameterService/ResetParameterToDefault"
    DEFAULT_PARAMETERS = "/rb.api.ParameterService/ResetAllParametersToDefault"
    LED = "/rb.api.LEDService/SetLEDColor"
    GET_TIME = "/rb.api.SystemService/GetSystemTime"
    SET_TIME = "/rb.api.SystemService/SetSystemTime"
    BATTERY_LEVEL = "/rb.api.SystemService/SetBatteryLevel"
    BATTERY_CONFIG = "/rb.api.SystemService/SetBatteryConfig"
    RESET_BATTERY = "/rb.api.SystemService/ResetBatteryConfig"
    LAST_LOG = "/rb.api.LogService/GetLastLog"
    LOG_STREAM = "/rb.api.LogService/GetLogStream"
    LOG_LEVEL = "/rb.api.LogService/SetLogLevel"
    FAULT_LOGS = "/rb.api.LogService/GetFaultLogList"
    DOWNLOAD = "/rb.api.FileService/DownloadFile"


class Manager(enum.IntEnum):
    """States of the control manager, the part of the robot's software that carries out commands."""

    UNKNOWN = 0
    IDLE = 1
    ENABLED = 2
    MINOR_FAULT = 3
    MAJOR_FAULT = 4


class Control(enum.IntEnum):
    """What the control manager does at present."""

    UNKNOWN = 0
    IDLE = 1
    EXECUTING = 2
    SWITCHING = 3


class ManagerOrder(enum.IntEnum):
    ENABLE = 1
    DISABLE = 2
    RESET_FAULT = 3


class PowerOrder(enum.IntEnum):
    ON = 1
    OFF = 2


class JointOrder(enum.IntEnum):
    SERVO_ON = 1
    BRAKE_ENGAGE = 2
    BRAKE_RELEASE = 3


class Done(enum.IntEnum):
    """Status in the answers to ``POWER``, ``JOINT``, ``SERVO_ON`` and ``SERVO_OFF``."""

    UNKNOWN = 0
    SUCCESS = 1
    INTERNAL_ERROR = 2


class Power(enum.IntEnum):
    UNKNOWN = 0
    ON = 1
    OFF = 2


def name_of(enum_type: type[enum.IntEnum], number: int) -> str:
    """Return the name and the number of an enum's value, as ``MAJOR_FAULT (4)``."""
    has_name = number in tuple(enum_type)
    return f"{enum_type(number).name if has_name else 'unknown'} ({number})"


# -- requests


def encode_order(name: str, order: int) -> bytes:
    """Encode ``PowerCommandRequest`` or ``JointCommandRequest``."""
    return pb.bytes_field(2, name.encode()) + pb.varint_field(3, order)


def decode_order(data: bytes) -> tuple[str, int]:
    """Decode a request: the names of joints or power supplies, and the order to them. Raise
    ``MalformedFrame``."""
    fields = pb.message(data)
    return text(pb.last_bytes(fields, 2)), pb.last_int(fields, 3)


def encode_manager_order(order: ManagerOrder) -> bytes:
    """Encode ``ControlManagerCommandRequest``."""
    return pb.varint_field(2, order)


def decode_manager_order(data: bytes) -> int:
    """Raise ``MalformedFrame``."""
    return pb.last_int(pb.message(data), 2)


def encode_rate(hz: float) -> bytes:
    """Encode ``GetRobotStateStreamRequest``."""
    return pb.double_field(2, hz)


def decode_rate(data: bytes) -> float:
    """Decode a request for a stream of states. Return the requested states per second. Raise
    ``MalformedFrame``."""
    return double(pb.message(data), 2)


# -- answers


def headed(answer: bytes, received_ns: int = 0, sent_ns: int = 0) -> bytes:
    """Put a ``ResponseHeader`` before an answer. Without a header that reports success, the
    vendor's client treats the call as failed.

    Args:
        answer: The answer.
        received_ns: When the robot received the request, by its own clock. 0 leaves both times out.
        sent_ns: When it sends the answer.
    """
    times = pb.bytes_field(2, _stamp(received_ns)) + pb.bytes_field(3, _stamp(sent_ns)) if received_ns else b""
    return pb.bytes_field(1, times + pb.bytes_field(4, pb.varint_field(1, _CODE_OK))) + answer


def refused(reason: str) -> bytes:
    """Encode an answer whose header reports an invalid request."""
    error = pb.varint_field(1, _CODE_INVALID_REQUEST) + pb.bytes_field(2, reason.encode())
    return pb.bytes_field(1, pb.bytes_field(4, error))


def error_of(answer: bytes) -> str:
    """Return the error in the header of an answer; empty if there is no error. Raise
    ``MalformedFrame``."""
    error = pb.message(pb.last_bytes(pb.message(pb.last_bytes(pb.message(answer), 1)), 4))
    code = pb.last_int(error, 1, _CODE_OK)
    return "" if code <= _CODE_OK else text(pb.last_bytes(error, 2)) or f"error {code}"


def encode_done(done: Done, message: str = "") -> bytes:
    return pb.varint_field(2, done) + (pb.bytes_field(3, message.encode()) if message else b"")


def decode_done(data: bytes) -> tuple[int, str]:
    """Decode the answer to an order: its status and message. Raise ``MalformedFrame``."""
    fields = pb.message(data)
    return pb.last_int(fields, 2), text(pb.last_bytes(fields, 3))


def encode_model(urdf: str) -> bytes:
    return pb.bytes_field(2, urdf.encode())


def decode_model(data: bytes) -> str:
    """Decode the answer with the robot's URDF. Raise ``MalformedFrame``."""
    return text(pb.last_bytes(pb.message(data), 2))


def encode_ready(ready: bool) -> bytes:
    """Encode ``WaitForControlReadyResponse``."""
    return pb.varint_field(3, int(ready))


class ManagerState(msgspec.Struct, frozen=True):
    """``ControlManagerState``."""

    state: int = Manager.UNKNOWN
    control: int = Control.UNKNOWN
    time_scale: float = 1.0
    enabled: tuple[int, ...] = ()  # indices of the enabled joints

    def encode(self) -> bytes:
        joints = b"".join(pb.varint_field(4, joint) for joint in self.enabled)
        return (
            pb.varint_field(1, self.state)
            + pb.double_field(2, self.time_scale)
            + pb.varint_field(3, self.control)
            + joints
        )

    @classmethod
    def decode(cls, data: bytes) -> ManagerState:
        """Raise ``MalformedFrame``."""
        fields = pb.message(data)
        return cls(pb.last_int(fields, 1), pb.last_int(fields, 3), double(fields, 2), pb.varints(data, 4))

    @property
    def text(self) -> str:
        return name_of(Manager, self.state)


def encode_manager_answer(state: ManagerState) -> bytes:
    """Encode ``ControlManagerCommandResponse`` or ``GetControlManagerStateResponse``."""
    return pb.bytes_field(2, state.encode())


def decode_manager_answer(data: bytes) -> ManagerState:
    """Raise ``MalformedFrame``."""
    return ManagerState.decode(pb.last_bytes(pb.message(data), 2))


class RobotInfo(msgspec.Struct, frozen=True):
    """The fields of a ``RobotInfo`` message that this driver uses."""

    model: str
    version: str
    joints: tuple[str, ...]  # names of the joints, in the order of every state
    supplies: tuple[str, ...] = ()
    emergency_stops: tuple[str, ...] = ()
    parts: tuple[tuple[str, tuple[int, ...]], ...] = ()  # name of a body part -> indices of its joints
    unbraked: tuple[str, ...] = ()  # joints without a brake

    @property
    def motor_supply(self) -> int | None:
        """Index of the motors' power supply in ``supplies`` and in every state; None if no supply
        has that name."""
        return self.supplies.index(MOTOR_SUPPLY) if MOTOR_SUPPLY in self.supplies else None

    def encode(self) -> bytes:
        """Encode ``GetRobotInfoResponse``."""
        info = (
            pb.bytes_field(1, self.model.encode())
            + b"".join(pb.bytes_field(3, pb.bytes_field(1, name.encode())) for name in self.supplies)
            + pb.varint_field(4, len(self.joints))
            + b"".join(pb.bytes_field(5, self._joint(name)) for name in self.joints)
            + b"".join(pb.bytes_field(11, pb.bytes_field(1, name.encode())) for name in self.emergency_stops)
            + pb.bytes_field(12, self.model.encode())
            + pb.bytes_field(16, self.version.encode())
            + pb.bytes_field(17, b"0.10.0")
            + pb.bytes_field(18, b"0.10.0")
        )
        parts = dict(self.parts)
        for number, part in _PARTS.items():
            info += b"".join(pb.varint_field(number, index) for index in parts.get(part, ()))
        return pb.bytes_field(2, info)

    def _joint(self, name: str) -> bytes:
        """Encode ``JointInfo``. The motors of the head are Dynamixels."""
        product = b"Dynamixel" if name.startswith("head") else b"RB"
        has_brake = name not in self.unbraked
        return (
            pb.bytes_field(1, name.encode())
            + pb.varint_field(2, int(has_brake))
            + pb.bytes_field(3, product)
            + pb.bytes_field(4, b"simulated")
        )

    @classmethod
    def decode(cls, data: bytes) -> RobotInfo:
        """Raise ``MalformedFrame``."""
        info = pb.last_bytes(pb.message(data), 2)
        fields = pb.message(info)
        return cls(
            text(pb.last_bytes(fields, 12)),
            text(pb.last_bytes(fields, 16)),
            _names(fields, 5),
            _names(fields, 3),
            _names(fields, 11),
            tuple((part, pb.varints(info, number)) for number, part in _PARTS.items()),
        )


_PARTS = {6: "mobility", 7: "body", 8: "head", 13: "torso", 14: "right_arm", 15: "left_arm"}


# -- decode single fields of a message


def messages(fields: dict[int, list[pb.Value]], number: int) -> Iterator[dict[int, list[pb.Value]]]:
    """Yield each message of a repeated field. Raise ``MalformedFrame``."""
    for value in fields.get(number, ()):
        if not isinstance(value, bytes):
            raise MalformedFrame(f"rb.api: field {number} is no message")
        yield pb.message(value)


def double(fields: dict[int, list[pb.Value]], number: int) -> float:
    """Decode a ``double`` field; 0 if the field is missing. Raise ``MalformedFrame``."""
    return pb.as_double(pb.last_int(fields, number))


def text(data: bytes) -> str:
    """Decode UTF-8. Raise ``MalformedFrame`` for anything else."""
    try:
        return data.decode()
    except UnicodeDecodeError:
        raise MalformedFrame("rb.api: a text that is no UTF-8") from None


def _stamp(time_ns: int) -> bytes:
    """Encode a ``Timestamp``."""
    seconds, nanos = divmod(time_ns, _NS)
    return pb.varint_field(1, seconds) + pb.varint_field(2, nanos)


def _names(fields: dict[int, list[pb.Value]], number: int) -> tuple[str, ...]:
    return tuple(text(pb.last_bytes(entry, 1)) for entry in messages(fields, number))
