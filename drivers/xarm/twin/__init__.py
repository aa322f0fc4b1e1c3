"""Simulate an xArm's controller: the control port and three report ports, with MuJoCo for the arm.

Besides the commands of every simulated robot, the control socket accepts ``error CODE`` (0 removes the error),
``state N`` and ``mode N``. They act as if another client of the controller had set these values. ``gripper error
CODE`` and ``gripper lost|found`` are faults of the gripper. ``object PERCENT`` puts something between its fingers,
which meet it when they are so far open, and under the vacuum gripper. ``object none`` takes it away.
"""

from __future__ import annotations

import errno
import functools
import socket
import time
from collections.abc import Callable, Iterator, Sequence
from typing import Annotated

from strands_actors.contract.options import option
from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.drivers.common.physics.controlled_body import SharedBody
from strands_actors.drivers.common.physics.handed_body import HandedBody
from strands_actors.drivers.common.physics.physics import Plant
from strands_actors.drivers.common.twin import (
    ClientGone,
    Exchange,
    Fault,
    Faults,
    Handler,
    HostOption,
    Reply,
    TcpServer,
    TwinRobot,
    WireLog,
    answering,
    main_of,
    own_host,
)
from strands_actors.drivers.xarm import protocol as p
from strands_actors.drivers.xarm.arms import arm_of
from strands_actors.drivers.xarm.grippers import Gripper

from .controller import TICK_HZ, Controller
from .modbus import FUNCTIONS, Modbus
from .publisher import HZ, Publisher
from .registers import REGISTERS

MODELLED = (REGISTERS, FUNCTIONS)


class XArmTwinOptions(HostOption, frozen=True):
    port: Annotated[
        int | None,
        option(
            f"TCP port for control; None: {p.CONTROL_PORT}, which the vendor's software expects, or any free port "
            "if this user may not use that one. The ports for reports are fixed"
        ),
    ] = None
    arm_type: Annotated[int, option("type in its version string: 3, 7 or 13")] = 7
    serial: Annotated[str, option("serial number of the arm")] = "XF1300012345"
    firmware: Annotated[str, option("version of its firmware")] = "1.12.10"
    speed_limit_rad_s: Annotated[float, option("joint speed limit that the controller reports, in rad/s", gt=0)] = (
        3.14159
    )
    gripper: Annotated[
        Gripper | None,
        option("the gripper on its flange, in the physics of the arm; None: one without physics on the tool's bus"),
    ] = None


class ControlSession:
    """The controller's end of one client's connection to the control port."""

    def __init__(self, controller: Controller, faults: Faults, modbus: Modbus | None = None) -> None:
        """Answer one client. Without ``modbus`` it has registers of its own for standard Modbus."""
        self._controller = controller
        self._faults = faults
        self._modbus = modbus or Modbus(controller)
        self._decoder = p.Decoder((*p.PROTOCOLS, p.STANDARD_MODBUS))
        # For each register, the data of the last reply, which a stuck controller repeats.
        self._last_data: dict[int, bytes] = {}

    def receive(self, data: bytes, bits_per_s: int | None) -> Iterator[Exchange]:
        try:
            for frame in self._decoder.feed(data):
                raw = p.frame(frame.number, frame.body, frame.protocol)
                if frame.protocol == p.HEARTBEAT_PROTOCOL:
                    yield Exchange("keepalive", raw, ())
                elif frame.protocol == p.STANDARD_MODBUS:
                    answer = p.frame(frame.number, self._modbus.answer(frame.body), frame.protocol)
                    reply = self._faults.apply(Reply(0.0, answer, None, "other"))
                    yield Exchange("other", raw, () if reply is None else (reply,))
                else:
                    message_type, brings_to = p.classify(frame.body)
                    yield Exchange(message_type, raw, self._replies(frame, message_type), brings_to)
        except MalformedFrame:
            # A real controller closes the connection when it receives an invalid frame.
            raise ClientGone from None

    def _replies(self, frame: p.Frame, message_type: str) -> Sequence[Reply]:
        register = frame.body[0]
        stuck = self._faults.of(None) is Fault.STUCK
        if stuck and message_type != "read":
            # A stuck controller replies and does not carry out the request.
            flags, data = self._controller.flags, b""
        else:
            flags, data = self._controller.obey(register, frame.body[1:])
            if stuck:
                data = self._last_data.get(register, data)
            self._last_data[register] = data
        answer = p.frame(frame.number, bytes((register, flags)) + data, frame.protocol)
        reply = self._faults.apply(Reply(0.0, answer, None, message_type))
        return () if reply is None else (reply,)


class XArmTwin(TwinRobot):
    """One simulated controller with its ports. A joint has a number from 1 to 7. After a restart the motors are
    off."""

    PARTS = range(1, p.JOINTS + 1)
    TICK_S = 1.0 / TICK_HZ
    RESTART_CUTS = True

    def __init__(self, controller: Controller, gripper: str = "") -> None:
        super().__init__()
        self.controller = controller
        arm = SharedBody(controller, lambda: controller.runs)
        self.body = HandedBody(arm, controller.devices.gripper.motion) if gripper else arm
        self._publisher = Publisher(controller, self.faults)

    def handlers(self, port: int) -> dict[int, Handler]:
        """Return the handlers of the control port ``port`` and of the ports for reports."""
        modbus = Modbus(self.controller)
        control = answering(functools.partial(ControlSession, self.controller, self.faults, modbus))
        return {port: control, **{number: functools.partial(self._publisher.serve, number) for number in HZ}}

    def jam(self, index: int, on: bool) -> None:
        self.controller.jam(index, on)

    def power_cycle(self) -> None:
        self.controller.wake_up()

    def tick(self) -> None:
        self.controller.tick()
        self._publisher.push(time.monotonic())

    def order(self, words: Sequence[str]) -> bool:
        match words:
            case ["error", code] if code.isdecimal():
                self.controller.fail(int(code))
            case ["state", number] if number.isdecimal():
                self.controller.set_state(int(number))
            case ["mode", number] if number.isdecimal():
                self.controller.set_mode(int(number))
            case ["gripper", "error", code] if code.isdecimal():
                self.controller.devices.gripper.fail(int(code))
            case ["gripper", "lost" | "found" as word]:
                self.controller.devices.gripper.lost = word == "lost"
            case ["object", place] if place == "none" or place.isdecimal():
                self.controller.devices.put_object(None if place == "none" else 1.0 - int(place) / 100)
            case _:
                return False
        return True


def may_bind(port: int) -> bool:
    """Return True if this user has the right to use the port, even if another program uses it now."""
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((own_host(), port))
        except OSError as error:
            return error.errno not in (errno.EACCES, errno.EPERM)
    return True


def controller_of(
    robot: str,
    *,
    arm_type: int = 7,
    serial: str = "XF1300012345",
    firmware: str = "1.12.10",
    speed_limit_rad_s: float = 3.14159,
    now_s: Callable[[], float] = time.monotonic,
    plant: Plant | None = None,
    gripper: str = "",
) -> Controller:
    """Return a simulated controller. Raise ``ValueError`` for an unknown ``arm_type``."""
    arm = arm_of(robot)
    text = f"{p.JOINTS},{arm_type},{serial},AC1300012345,v{firmware}"
    index = arm.type_index(p.parse_version(text.encode()))
    if index is None:
        numbers = ", ".join(map(str, sorted({each.number for each in arm.types})))
        raise ValueError(f"arm_type is {arm_type}. Use one of {numbers}")
    arm_type_used = arm.types[index]
    return Controller(
        robot, arm_type_used, text, speed_limit_rad_s=speed_limit_rad_s, now_s=now_s, plant=plant, gripper=gripper
    )


def build(robot: str, options: XArmTwinOptions, log: WireLog) -> TcpServer:
    """Return the server of a robot. Raise ``ValueError`` for an unknown ``arm_type``."""
    port = (p.CONTROL_PORT if may_bind(p.CONTROL_PORT) else 0) if options.port is None else options.port
    twin = XArmTwin(
        controller_of(
            robot,
            arm_type=options.arm_type,
            serial=options.serial,
            firmware=options.firmware,
            speed_limit_rad_s=options.speed_limit_rad_s,
            gripper=options.gripper or "",
        ),
        options.gripper or "",
    )
    return TcpServer(twin, twin.handlers(port), log, options.host)


main = main_of(XArmTwinOptions, build)
