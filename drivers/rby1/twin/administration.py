"""Answer the calls that set up the simulated robot, or read something of it besides its state.

Each function takes the request, and returns the answer without its header. ``Invalid`` is answered by an error in
the header, ``Rejected`` by a gRPC status: the vendor's client does not look at the header of such an answer.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

from strands_actors.drivers.common.codecs import protobuf as pb
from strands_actors.drivers.common.codecs.grpc_messages import Status
from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.drivers.rby1 import protocol as p
from strands_actors.drivers.rby1.commands import PARTS, decode_duration
from strands_actors.drivers.rby1.model import limits_of
from strands_actors.drivers.rby1.protocol import MOTOR_SUPPLY, Done, Method, double, text

from .controller import Controller
from .devices import VOLTS, Flange, Gains, Led
from .journal import NS, Level, stamped
from .parameters import Invalid

Fields = dict[int, list[pb.Value]]
Answer = Callable[[Controller, Fields], bytes]

MOST_LINES = 1000
_TARGETS = dict(enumerate(PARTS, 1))
"""Components of a request for gains, by their numbers."""


class Rejected(Invalid):
    """A request that the robot answers with a gRPC status."""

    def __init__(self, status: Status, reason: str) -> None:
        super().__init__(reason)
        self.status = status


# -- parameters


def _list_parameters(robot: Controller, request: Fields) -> bytes:
    rows = (
        pb.bytes_field(1, name.encode()) + pb.varint_field(2, kind)
        for name, kind in robot.devices.parameters.listed()
    )
    return b"".join(pb.bytes_field(2, row) for row in rows)


def _get_parameter(robot: Controller, request: Fields) -> bytes:
    return pb.bytes_field(2, robot.devices.parameters.encoded(_name(request)).encode())


def _set_parameter(robot: Controller, request: Fields) -> bytes:
    robot.devices.parameters.set(_name(request), text(pb.last_bytes(request, 3)))
    return b""


def _reset_parameter(robot: Controller, request: Fields) -> bytes:
    robot.devices.parameters.reset(_name(request) or "?")
    return b""


def _reset_parameters(robot: Controller, request: Fields) -> bytes:
    robot.devices.parameters.reset()
    return b""


def _restore_parameter(robot: Controller, request: Fields) -> bytes:
    robot.devices.parameters.restore(_name(request) or "?")
    return b""


def _restore_parameters(robot: Controller, request: Fields) -> bytes:
    robot.devices.parameters.restore()
    return b""


# -- gains of the joints


def _get_gains(robot: Controller, request: Fields) -> bytes:
    devices, name = robot.devices, _name(request)
    if not robot.supplies[MOTOR_SUPPLY]:
        raise Rejected(Status.FAILED_PRECONDITION, "the motors have no power")
    if 3 in request:
        part = _TARGETS.get(pb.last_int(request, 3), "")
        names = [f"{part}_{number}" for number in range(PARTS.get(part, 0))]
    else:
        names = [name] if name in devices.gains else []
    if not names:
        raise Rejected(Status.INVALID_ARGUMENT, f"no joint {name[:64]!r}")
    stamp = pb.bytes_field(1, stamped(robot.time_ns))
    return b"".join(pb.bytes_field(2, stamp + _encoded(devices.gains[each])) for each in names)


def _encoded(gains: Gains) -> bytes:
    return b"".join(pb.varint_field(number, gain) for number, gain in enumerate(gains, 2))


def _set_gains(robot: Controller, request: Fields) -> bytes:
    wrapped = [pb.message(pb.last_bytes(request, number)) if number in request else None for number in (3, 4, 5)]
    p_gain, i_gain, d_gain = (None if entry is None else pb.last_int(entry, 1) for entry in wrapped)
    done = robot.set_gains(_name(request), (p_gain, i_gain, d_gain))
    return p.encode_done(Done.SUCCESS) if done else p.encode_done(Done.INTERNAL_ERROR, "not possible now")


# -- LED, tool flanges


def _set_led(robot: Controller, request: Fields) -> bytes:
    color = pb.message(pb.last_bytes(request, 2))
    red, green, blue = (pb.last_int(color, number) for number in (1, 2, 3))
    if max(red, green, blue) > 255:
        raise Invalid(f"the colour {red}, {green}, {blue} is beyond 255")
    blinks_hz = double(pb.message(pb.last_bytes(request, 6)), 1) if 6 in request else 1.0
    if not 0.0 < blinks_hz < math.inf:
        raise Invalid(f"{blinks_hz} Hz")
    robot.devices.led = Led(
        (red, green, blue),
        decode_duration(pb.last_bytes(request, 3)) if 3 in request else 1.0,
        decode_duration(pb.last_bytes(request, 4)),
        blinks_hz if pb.last_int(request, 5) else 0.0,
    )
    return b""


def _flange(robot: Controller, request: Fields) -> Flange:
    flange = robot.devices.flanges.get(_name(request))
    if flange is None:
        raise Invalid(f"no tool flange {_name(request)[:64]!r}")
    if not robot.supplies[MOTOR_SUPPLY]:
        raise Invalid("the tool flange has no power")
    return flange


def _set_flange_power(robot: Controller, request: Fields) -> bytes:
    order = pb.last_int(request, 3)
    if order not in VOLTS:
        raise Invalid(f"no order {order}")
    _flange(robot, request).volts = VOLTS[order]
    return b""


def _set_flange_output(robot: Controller, request: Fields) -> bytes:
    flange = _flange(robot, request)
    if 3 in request:
        single = pb.message(pb.last_bytes(request, 3))
        channel = pb.last_int(single, 1)
        if channel >= len(flange.outputs):
            raise Invalid(f"no channel {channel}")
        flange.outputs[channel] = bool(pb.last_int(single, 2))
    elif 4 in request:
        dual = pb.message(pb.last_bytes(request, 4))
        flange.outputs = [bool(pb.last_int(dual, 1)), bool(pb.last_int(dual, 2))]
    else:
        raise Invalid("no output")
    return b""


# -- model, time, odometry


def _import_model(robot: Controller, request: Fields) -> bytes:
    name, urdf = _name(request), text(pb.last_bytes(request, 3))
    if not name:
        raise Invalid("the model has no name")
    try:
        limits_of(urdf, robot.plant.joints)
    except MalformedFrame as malformed:
        raise Invalid(str(malformed)) from None
    robot.devices.models[name] = urdf
    return b""


def _get_time_scale(robot: Controller, request: Fields) -> bytes:
    return pb.double_field(2, robot.time_scale)


def _set_time_scale(robot: Controller, request: Fields) -> bytes:
    scale = double(request, 2)
    if not 0.0 <= scale <= 1.0:
        raise Invalid(f"a time scale of {scale}")
    robot.set_time_scale(scale)
    return pb.double_field(2, robot.time_scale)


def _get_time(robot: Controller, request: Fields) -> bytes:
    clock, now_ns = robot.devices.clock, robot.time_ns
    return (
        pb.bytes_field(2, stamped(now_ns))
        + pb.bytes_field(3, clock.zone.encode())
        + pb.bytes_field(4, clock.local(now_ns).encode())
    )


def _set_time(robot: Controller, request: Fields) -> bytes:
    stamp = pb.message(pb.last_bytes(request, 2))
    seconds, nanos = pb.last_int(stamp, 1), pb.last_int(stamp, 2)
    if not 0 < seconds < 1 << 33 or nanos >= NS:
        raise Invalid(f"{seconds} s is no time")
    robot.set_time(seconds * NS + nanos, text(pb.last_bytes(request, 3)))
    return b""


def _reset_odometry(robot: Controller, request: Fields) -> bytes:
    pose = pb.message(pb.last_bytes(request, 2))
    place = pb.message(pb.last_bytes(pose, 1))
    x, y, angle = double(place, 1), double(place, 2), double(pose, 2)
    if not all(map(math.isfinite, (x, y, angle))):
        raise Invalid(f"a pose of {x}, {y}, {angle}")
    robot.base.pose = (x, y, angle)
    return b""


# -- battery


def _set_battery_level(robot: Controller, request: Fields) -> bytes:
    robot.devices.battery.fix(double(request, 2))
    return b""


def _set_battery_config(robot: Controller, request: Fields) -> bytes:
    encoded = b"".join(pb.bytes_field(4, each) for each in request.get(4, ()) if isinstance(each, bytes))
    coefficients = pb.doubles(encoded, 4)
    robot.devices.battery.configure([double(request, 2), double(request, 3), *coefficients])
    return b""


def _reset_battery(robot: Controller, request: Fields) -> bytes:
    robot.devices.battery.reset()
    return b""


# -- the log


def _last_log(robot: Controller, request: Fields) -> bytes:
    count = min(MOST_LINES, pb.last_int(request, 2))
    return b"".join(pb.bytes_field(2, line.encode()) for line in robot.devices.journal.last(count))


def _set_log_level(robot: Controller, request: Fields) -> bytes:
    level = pb.last_int(request, 2)
    if level not in tuple(Level):
        raise Invalid(f"no log level {level}")
    robot.devices.journal.level = Level(level)
    return b""


def _fault_logs(robot: Controller, request: Fields) -> bytes:
    return b"".join(pb.bytes_field(2, name.encode()) for name in robot.devices.journal.faults)


def _download(robot: Controller, request: Fields) -> bytes:
    content = robot.devices.journal.faults.get(_name(request))
    if content is None:
        raise Invalid(f"no file {_name(request)[:64]!r}")
    return pb.bytes_field(2, content)


def _name(request: Fields) -> str:
    return text(pb.last_bytes(request, 2))


ANSWERS: Mapping[Method, Answer] = {
    Method.GET_PARAMETERS: _list_parameters,
    Method.GET_PARAMETER: _get_parameter,
    Method.SET_PARAMETER: _set_parameter,
    Method.RESET_PARAMETER: _reset_parameter,
    Method.RESET_PARAMETERS: _reset_parameters,
    Method.FACTORY_PARAMETER: _restore_parameter,
    Method.FACTORY_PARAMETERS: _restore_parameters,
    Method.DEFAULT_PARAMETER: _restore_parameter,
    Method.DEFAULT_PARAMETERS: _restore_parameters,
    Method.GET_GAINS: _get_gains,
    Method.SET_GAINS: _set_gains,
    Method.LED: _set_led,
    Method.FLANGE_POWER: _set_flange_power,
    Method.FLANGE_OUTPUT: _set_flange_output,
    Method.IMPORT_ROBOT_MODEL: _import_model,
    Method.GET_TIME_SCALE: _get_time_scale,
    Method.SET_TIME_SCALE: _set_time_scale,
    Method.GET_TIME: _get_time,
    Method.SET_TIME: _set_time,
    Method.BATTERY_LEVEL: _set_battery_level,
    Method.BATTERY_CONFIG: _set_battery_config,
    Method.RESET_BATTERY: _reset_battery,
    Method.RESET_ODOMETRY: _reset_odometry,
    Method.LAST_LOG: _last_log,
    Method.LOG_LEVEL: _set_log_level,
    Method.FAULT_LOGS: _fault_logs,
    Method.DOWNLOAD: _download,
}

READS = frozenset(
    (
        Method.GET_PARAMETERS,
        Method.GET_PARAMETER,
        Method.GET_GAINS,
        Method.GET_TIME_SCALE,
        Method.GET_TIME,
        Method.LAST_LOG,
        Method.LOG_STREAM,
        Method.FAULT_LOGS,
        Method.DOWNLOAD,
    )
)
"""Those that change nothing."""
