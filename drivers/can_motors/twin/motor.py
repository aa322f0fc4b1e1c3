"""The firmware of one simulated motor: its states, parameters and timeout, and its answers to frames."""

from __future__ import annotations

import struct
from abc import ABC, abstractmethod
from typing import Any, NamedTuple

from strands_actors.contract.safe_state import SafeState
from strands_actors.drivers.can_motors.protocol import (
    HOST,
    TICKS_PER_S,
    Damiao,
    Frame,
    RobStride,
    State,
    from_code,
    to_code,
    zero_code,
)
from strands_actors.drivers.can_motors.robots import Motor
from strands_actors.drivers.common.physics.physics import Plant
from strands_actors.drivers.common.twin.faults import Fault
from strands_actors.drivers.common.twin.modelled import Modelled

WRONG_RAD = 1.0
ZERO = 0xFE
ROOM_C = 28.0


class Done(NamedTuple):
    """The effect of a frame on a motor.

    Attributes:
        kind: The kind of the frame, for the log.
        state: The state to which it brings the motor.
        replies: The answers.
    """

    kind: str
    state: str
    replies: tuple[Frame, ...] = ()


class MitPlant(Plant):
    """A simulated arm with joints that may also be driven in MIT mode."""

    def drive(self, index: int, q: float, dq: float, tau: float, kp: float, kd: float) -> None:
        """Set the command of a joint: the torque ``kp (q - position) + kd (dq - velocity) + tau``."""
        servo = self._actuator[index]
        self.model.actuator_gainprm[servo, 0] = 1.0
        self.model.actuator_biasprm[servo, 1:3] = -kp, -kd
        self.set_target(index, kp * q + kd * dq + tau)


class SimMotor(ABC):
    """One simulated motor on its joint."""

    def __init__(self, motor: Motor, plant: MitPlant, index: int) -> None:
        self.motor = motor
        self.ranges = motor.type.ranges
        self.index = index
        self.state = State.DISABLED
        self.fault = Fault.OK
        self.temperature_c = ROOM_C
        self.parameters: dict[int, bytes] = self.fresh()
        self.last_s = 0.0
        """Time of the last frame that resets the timeout."""
        self.commanded = ""
        """The state to which the last command has brought this motor: setpoint or a safe state."""
        self._plant = plant
        self.zero_rad = 0.0
        """Position of the motor that it counts as 0."""
        self._frozen: tuple[float, float, float] | None = None

    @abstractmethod
    def fresh(self) -> dict[int, bytes]:
        """Return the parameters at delivery."""

    @abstractmethod
    def receive(self, frame: Frame) -> Done | None:
        """Carry out a frame. Return None if it is not for this motor."""

    @property
    def unit(self) -> int:
        """The number of the motor in faults: its id, and 100 more on each further bus."""
        return self.motor.id + 100 * self.motor.bus

    # -- what happens to the motor

    def set_fault(self, fault: Fault) -> None:
        self._frozen = self.reading() if fault is Fault.STUCK else None
        self._plant.set_stuck(self.index, fault is Fault.STUCK)
        if Fault.OFF in (fault, self.fault) and fault is not self.fault:
            self.power_cycle()
        self.fault = fault

    def power_cycle(self) -> None:
        self.parameters = self.fresh()
        self.switch(State.DISABLED)

    def switch(self, state: State) -> None:
        """Enter a state. Only in the state ENABLED the motor has torque, and it begins without a command."""
        if state is self.state:
            return
        self.state = state
        self._plant.set_torque(self.index, state is State.ENABLED)
        if state is State.ENABLED:
            self._plant.drive(self.index, 0.0, 0.0, 0.0, 0.0, 0.0)

    def overdue_s(self) -> float | None:
        """Return the time at which the motor switches its torque off; None if it does not."""
        ticks = int.from_bytes(self.parameters[self.timeout], "little")
        return self.last_s + ticks / TICKS_PER_S if ticks and self.state is State.ENABLED else None

    @property
    @abstractmethod
    def timeout(self) -> int: ...

    # -- its shaft

    def reading(self) -> tuple[float, float, float]:
        """Return position, velocity and torque of the motor (not of the joint)."""
        if self._frozen is not None:
            return self._frozen
        plant, motor = self._plant, self.motor
        wrong = WRONG_RAD if self.fault is Fault.WRONG else 0.0
        nm = plant.effort_nm[self.index] if self.state is State.ENABLED else 0.0
        rad, rad_s = plant.position_rad[self.index], plant.velocity_rad_s[self.index]
        return motor.sign * rad + motor.offset - self.zero_rad + wrong, motor.sign * rad_s, motor.sign * nm

    def codes(self, bits: int) -> tuple[int, int, int]:
        ranges = self.ranges
        q, dq, tau = self.reading()
        return (
            to_code(q, -ranges.position, ranges.position, 16),
            to_code(dq, -ranges.velocity, ranges.velocity, bits),
            to_code(tau, -ranges.torque, ranges.torque, bits),
        )

    def drive(self, q: int, dq: int, tau: int, kp: int, kd: int, bits: int) -> tuple[str, str]:
        """Carry out a command. Return its kind and state for the log."""
        ranges, sign = self.ranges, self.motor.sign
        held = dq == zero_code(bits, True)
        speed = 0.0 if dq in (zero_code(bits, True), zero_code(bits, False)) else 1.0
        nothing = tau in (zero_code(bits, True), zero_code(bits, False))
        stiffness, braking = from_code(kp, 0, ranges.kp, bits), from_code(kd, 0, ranges.kd, bits)
        if self.state is State.ENABLED:
            self._plant.drive(
                self.index,
                sign * (from_code(q, -ranges.position, ranges.position, 16) + self.zero_rad - self.motor.offset),
                sign * speed * from_code(dq, -ranges.velocity, ranges.velocity, bits),
                0.0 if nothing else sign * from_code(tau, -ranges.torque, ranges.torque, bits),
                stiffness,
                braking,
            )
        if kp == 0 and nothing and not speed:
            self.commanded = SafeState.DAMP if kd else SafeState.ZERO_TORQUE
        else:
            self.commanded = SafeState.HOLD if held else "setpoint"
        return ("setpoint" if self.commanded == "setpoint" else "safe"), self.commanded

    def enable(self) -> None:
        """Take torque, unless a fault is latched."""
        if self.state is State.DISABLED:
            self.switch(State.ENABLED)

    def disable(self) -> tuple[str, str]:
        """Give the torque up. A latched fault stays. Return kind and state for the log."""
        self.commanded = SafeState.LIMP
        if self.state is State.ENABLED:
            self.switch(State.DISABLED)
        return "safe", self.commanded

    def clear(self) -> None:
        """Clear a latched fault. A motor with torque keeps it."""
        if self.state is not State.ENABLED:
            self.switch(State.DISABLED)


DAMIAO_COMMANDS: Modelled[int] = Modelled(
    "Damiao: last byte of a command of seven bytes FF",
    {
        Damiao.ENABLE: "switches the torque on, unless a fault is latched",
        Damiao.DISABLE: "switches the torque off",
        Damiao.CLEAR: "clears a latched fault",
        ZERO: "makes the present position the zero of the motor",
    },
    "it counts as a command in MIT mode, as every frame with the motor's id",
)
DAMIAO_REGISTERS: Modelled[int] = Modelled(
    "Damiao: registers",
    {
        7: "id of the feedback",
        8: "id of the motor",
        9: "timeout in units of 50 us",
        10: "mode: 1 (MIT) only",
        14: "version of the software",
        21: "range of positions",
        22: "range of velocities",
        23: "range of torques",
    },
    "silence",
)
ROBSTRIDE_TYPES: Modelled[int] = Modelled(
    "RobStride: types of messages",
    {
        0x00: "returns the motor's own number",
        RobStride.COMMAND: "a command in MIT mode",
        RobStride.ENABLE: "switches the torque on, unless a fault is latched",
        RobStride.DISABLE: "switches the torque off; with 1 in the first byte it also clears a latched fault",
        RobStride.READ: "reads 0x7005 (mode), 0x7019 (position), 0x701B (velocity), 0x701C (supply), 0x7028",
        RobStride.WRITE: "writes a parameter: 0x7005 (0 only), 0x7028",
    },
    "silence",
)
ROBSTRIDE_MIT: Modelled[int] = Modelled(
    "RobStride in the MIT protocol: last byte of a command of seven bytes FF",
    {
        Damiao.ENABLE: "switches the torque on, unless a fault is latched",
        Damiao.DISABLE: "switches the torque off",
        Damiao.CLEAR: "clears a latched fault",
    },
    "it counts as no command",
)
MODELLED = (DAMIAO_COMMANDS, DAMIAO_REGISTERS, ROBSTRIDE_TYPES, ROBSTRIDE_MIT)
_WRITABLE = {9: (0, 0xFFFFFFFF), 10: (1, 1)}


def mit_numbers(data: bytes) -> tuple[int, int, int, int, int]:
    """Return q, dq, tau, kp and kd of a command of eight bytes."""
    whole = int.from_bytes(data, "big")
    return whole >> 48, whole >> 36 & 0xFFF, whole & 0xFFF, whole >> 24 & 0xFFF, whole >> 12 & 0xFFF


def _u32(value: int) -> bytes:
    return value.to_bytes(4, "little")


def _f32(value: float) -> bytes:
    return struct.pack("<f", value)


class SimDamiao(SimMotor):
    timeout = Damiao.TIMEOUT

    def fresh(self) -> dict[int, bytes]:
        motor, ranges = self.motor, self.ranges
        numbers = {7: motor.feedback_id, 8: motor.id, 9: 0, 10: 1, 14: 5015}
        reals = zip(Damiao.RANGES, (ranges.position, ranges.velocity, ranges.torque), strict=True)
        return {number: _u32(value) for number, value in numbers.items()} | {n: _f32(value) for n, value in reals}

    def receive(self, frame: Frame) -> Done | None:
        data = frame.data
        if frame.extended or len(data) != 8:
            return None
        if frame.id == Damiao.PARAMETERS:
            return self._parameter(data) if int.from_bytes(data[:2], "little") == self.motor.id else None
        if frame.id != self.motor.id:
            return None
        kind, commanded = "other", ""
        if data[:7] == b"\xff" * 7 and data[7] in DAMIAO_COMMANDS:
            if data[7] == Damiao.ENABLE:
                kind = "enable"
                self.enable()
            elif data[7] == Damiao.DISABLE:
                kind, commanded = self.disable()
            elif data[7] == Damiao.CLEAR:
                self.clear()
                kind = "config"
            elif data[7] == ZERO:
                self.zero_rad += self.reading()[0]
                kind = "config"
        else:
            kind, commanded = self.drive(*mit_numbers(data), Damiao.BITS)
        return Done(kind, commanded, (self._feedback(),))

    def _parameter(self, data: bytes) -> Done:
        code, number = data[2], data[3]
        if code == Damiao.ASK:
            return Done("read", "", (self._feedback(),))
        if code not in (Damiao.READ, Damiao.WRITE) or number not in DAMIAO_REGISTERS:
            return Done("other", "")
        if code == Damiao.WRITE:
            low, high = _WRITABLE.get(number, (1, 0))
            if not low <= int.from_bytes(data[4:], "little") <= high:
                return Done("other", "")
            self.parameters[number] = data[4:]
        reply = data[:4] + self.parameters[number]
        kind = "config" if code == Damiao.WRITE else "read"
        return Done(kind, "", (Frame(self.motor.feedback_id, reply),))

    def _feedback(self) -> Frame:
        q, dq, tau = self.codes(Damiao.BITS)
        celsius = min(255, round(self.temperature_c))
        head = self.motor.id & 0xF | self.state << 4
        middle = (q << 24 | dq << 12 | tau).to_bytes(5, "big")
        return Frame(self.motor.feedback_id, bytes((head,)) + middle + bytes((celsius, celsius)))


class SimRobStride(SimMotor):
    """A RobStride motor. It speaks the private protocol, and in ``speaks_mit`` the MIT protocol instead."""

    timeout = RobStride.TIMEOUT
    SUPPLY_V = 48.0
    speaks_mit = False

    def fresh(self) -> dict[int, bytes]:
        return {RobStride.MODE: _u32(0), RobStride.TIMEOUT: _u32(0), 0x701C: _f32(self.SUPPLY_V)}

    def receive(self, frame: Frame) -> Done | None:
        if frame.extended is self.speaks_mit or frame.id & 0xFF != self.motor.id or len(frame.data) != 8:
            return None
        if self.speaks_mit:
            return self._receive_mit(frame.data)
        kind, data = frame.id >> 24, frame.data
        commanded = ""
        match kind:
            case RobStride.COMMAND:
                q, dq, kp, kd = struct.unpack(">HHHH", data)
                label, commanded = self.drive(q, dq, frame.id >> 8 & 0xFFFF, kp, kd, RobStride.BITS)
            case RobStride.ENABLE:
                label = "enable"
                self.enable()
            case RobStride.DISABLE if data[0]:
                label = "config"
                self.switch(State.DISABLED)
            case RobStride.DISABLE:
                label, commanded = self.disable()
            case RobStride.READ:
                return self._read(frame, int.from_bytes(data[:2], "little"))
            case RobStride.WRITE:
                number, value = int.from_bytes(data[:2], "little"), data[4:]
                if number == RobStride.MODE and value[0] == RobStride.MIT:
                    label = "read"
                elif number == RobStride.TIMEOUT:
                    label = "config"
                    self.parameters[number] = value
                else:
                    return Done("other", "")
            case 0x00:
                uid = self.motor.id.to_bytes(8, "little")
                return Done("read", "", (Frame(self.motor.id << 8 | 0xFE, uid, True),))
            case _:
                return Done("other", "")
        return Done(label, commanded, (self._feedback(),))

    def _receive_mit(self, data: bytes) -> Done:
        """Carry out a frame of the MIT protocol: that of Damiao's motors, without registers."""
        kind, commanded = "other", ""
        if data[:7] == b"\xff" * 7 and data[7] in ROBSTRIDE_MIT:
            if data[7] == Damiao.ENABLE:
                kind = "enable"
                self.enable()
            elif data[7] == Damiao.DISABLE:
                kind, commanded = self.disable()
            else:
                kind = "read"
                self.clear()
        elif data[:6] != b"\xff" * 6:
            kind, commanded = self.drive(*mit_numbers(data), Damiao.BITS)
        q, dq, tau = self.codes(Damiao.BITS)
        middle = (q << 24 | dq << 12 | tau).to_bytes(5, "big")
        tenths = round(self.temperature_c * 10).to_bytes(2, "big")
        return Done(kind, commanded, (Frame(HOST, bytes((self.motor.id,)) + middle + tenths),))

    def _read(self, frame: Frame, number: int) -> Done:
        q, dq, _ = self.reading()
        live = {0x7019: q, 0x701B: dq}
        value = _f32(live[number]) if number in live else self.parameters.get(number)
        if value is None:
            return Done("other", "")
        reply = Frame(
            RobStride.READ << 24 | self.motor.id << 8 | frame.id >> 8 & 0xFF, frame.data[:4] + value, True
        )
        return Done("read", "", (reply,))

    def _feedback(self) -> Frame:
        q, dq, tau = self.codes(RobStride.BITS)
        faults = sum(1 << place for place, fault in enumerate(RobStride.FAULTS) if fault is self.state)
        mode = RobStride.RUNS if self.state is State.ENABLED else 0
        number = RobStride.FEEDBACK << 24 | mode << 22 | faults << 16 | self.motor.id << 8 | HOST
        return Frame(number, struct.pack(">HHHH", q, dq, tau, round(self.temperature_c * 10)), True)


SIMULATED: dict[str, Any] = {"damiao": SimDamiao, "robstride": SimRobStride}
