"""Simulate the firmware: commander, supervisor, high-level commander, log, parameters, memories. No sockets.

The watchdog is that of the real firmware. Without a setpoint it levels out after 0.5 s, and after 2 s it cuts the
motors and locks the drone. The high-level commander has no watchdog, and flies its plan to the end.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Iterator, Mapping
from typing import Any

from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.drivers.crazyflie import protocol as p
from strands_actors.drivers.crazyflie.config import LANDING_M_S
from strands_actors.drivers.crazyflie.protocol import Battery, Bit, HighLevel, Order, Port, Setpoint

from . import packets, setpoints
from .body import LONGEST_S, TIMESTEP_S, FlyingBody, Target
from .estimator import Estimator
from .log_port import LogPort
from .memories import Memories
from .packets import Reaction, answer
from .parameter_port import ParameterPort
from .planner import Planner
from .planner import State as PlannerState
from .supervisor import PERIOD_S, Seen, State, Supervisor
from .tables import Reading

LOW_POWER_S = 5.0
"""How long the voltage has to be low until the firmware reports low power."""
VERSION, DEVICE = b"twin", b"Crazyflie 2.1 Brushless"
ADDRESS = 0xE7
"""Last byte of the radio's address."""
_SUPERVISE_STEPS = round(PERIOD_S / TIMESTEP_S)
_RESET = "kalman.resetEstimation"
_POSITION_GROUP = "posCtlPid."

_LANDS = (HighLevel.OLD_LAND, HighLevel.LAND, HighLevel.LAND_WITH_VELOCITY)
_SETTINGS = (HighLevel.SET_GROUP_MASK, HighLevel.DEFINE_TRAJECTORY)


class Firmware:
    def __init__(
        self,
        table: Mapping[str, Any],
        now_s: Callable[[], float],
        *,
        protocol: int = p.OLDEST,
        auto_arm: bool = False,
        spin_up_s: float = 0.0,
        note: Callable[[str], None] = lambda text: None,
    ) -> None:
        """Start the firmware.

        Args:
            table: The robot's table.
            now_s: Returns the present time.
            protocol: CRTP protocol version that it reports.
            auto_arm: Arm without a request.
            spin_up_s: How long motors need to spin up after arming.
            note: Called with a text for each action of the watchdog or the supervisor.
        """
        self.body = FlyingBody(table)
        self.memories = Memories()
        self.log = LogPort()
        self.estimator = Estimator(self.body)
        self.parameters = ParameterPort(self._take_parameter)
        self._now_s = now_s
        self._protocol = protocol
        self._auto_arm, self._spin_up_s = auto_arm, spin_up_s
        self._note = note
        self._updated_s = now_s()
        self.battery_v = 4.0
        self.stuck: Reading | None = None  # the report that a log with the fault "stuck" repeats
        self.wrong_m = 0.0
        self.boot()

    def boot(self) -> None:
        """Restart the firmware as after switching the drone off and on. The drone stays where it is."""
        self._booted_s = self.time_s
        self.memories.boot()
        self.log.boot()
        self.parameters.boot()
        values = self.parameters.values
        for name in values:
            if name.startswith(_POSITION_GROUP):
                self._take_parameter(name)
        self.estimator.reset((0.0, 0.0, 0.0), self.body.rpy_rad[2])
        self.planner = Planner(values, self.memories.trajectories)
        self.supervisor = Supervisor(self._auto_arm, self._spin_up_s, values, lambda text: self._note(text))
        self._setpoint: Target | None = None
        self._setpoint_s: float | None = None  # None while the high-level commander has priority
        self._high_level_s = self._charged_s = self.time_s
        self._thrust_locked = True
        self._steps = 0
        self._unasked: list[bytes] = []
        self.simulated = False  # True while a local simulation flies the drone instead of a client
        self._simulated: Target | None = None

    def reset(self) -> None:
        """Put the drone back on the floor at its start, and restart the firmware."""
        self.body.reset()
        self.boot()

    # -- time

    @property
    def time_s(self) -> float:
        return self.body.time_s

    @property
    def motors_on(self) -> bool:
        return self.body.target is not None

    def pass_time(self) -> None:
        """Advance the simulation to the present time."""
        now_s = self._now_s()
        passed_s, self._updated_s = min(now_s - self._updated_s, LONGEST_S), now_s
        for _ in range(round(passed_s / TIMESTEP_S)):
            self.step()

    def step(self) -> None:
        """Advance the simulated firmware and its body by one time step."""
        self._steps += 1
        if self._steps % _SUPERVISE_STEPS == 0:
            self._supervise()
        target = self._present_target()
        # Without thrust no motor turns.
        is_off = target is None or target.lift == 0
        self.body.target = None if target is None or is_off else self.estimator.to_world(target)
        self.body.step()

    def fly(self, target: Target | None) -> None:
        """Obey a setpoint of a local simulation, in the place of a client; None switches the motors off."""
        self._simulated = target
        self.planner.stop()

    def descend(self) -> None:
        """Land for a local simulation, in the place of a client."""
        if self._simulated is not None:
            self._simulated = None
            start = self.estimator.moment
            self.planner.land(start, max(0.0, start.xyz_m[2]) / LANDING_M_S, self.time_s)

    def _present_target(self) -> Target | None:
        """Return the setpoint that is obeyed, in the frame of the estimate; None if motors are off."""
        if self.simulated:
            return self.planner.target(self.time_s) or self._simulated
        if not self.supervisor.motors_may_turn:
            return None
        if self._setpoint_s is None:
            return self.planner.target(self.time_s)
        if self._setpoint is not None and self.supervisor.state is State.LEVEL_OUT:
            return self._setpoint.levelled()
        return self._setpoint

    def _supervise(self) -> None:
        now_s = self.time_s
        planner = self.planner.state_at(now_s)
        if planner is not PlannerState.DISABLED:
            self._high_level_s = now_s
        if self.battery_v > self.parameters.values["pm.lowVoltage"]:
            self._charged_s = now_s
        age_s = now_s - (self._high_level_s if self._setpoint_s is None else self._setpoint_s)
        flags = {
            # This flag is set even while the drone obeys a setpoint instead of the plan.
            Bit.HIGH_LEVEL_ACTIVE: planner in (PlannerState.FLYING, PlannerState.LANDING),
            Bit.TRAJECTORY_FINISHED: self.planner.is_finished(now_s),
            Bit.HIGH_LEVEL_DISABLED: planner is PlannerState.DISABLED,
        }
        high_level = Bit(sum(bit for bit, on in flags.items() if on))
        self.supervisor.update(Seen(now_s, self.body.lift > 0, self.body.acceleration_g, age_s, high_level))
        if not (self.supervisor.motors_may_turn or self.simulated):
            self.planner.stop()

    # -- reports

    @property
    def armed(self) -> bool:
        return self.supervisor.armed

    @property
    def locked(self) -> bool:
        return self.supervisor.state is State.LOCKED

    @property
    def bits(self) -> Bit:
        return self.supervisor.bits

    @property
    def reading(self) -> Reading:
        if self.stuck is not None:
            return self.stuck
        body, estimator = self.body, self.estimator
        x, y, z = estimator.xyz_m
        is_low = self.time_s - self._charged_s > LOW_POWER_S
        return Reading(
            (x, y, z + self.wrong_m),
            estimator.velocity_m_s,
            estimator.rpy_rad,
            body.turn_rad_s,
            body.acceleration_g,
            estimator.place_variances,
            estimator.speed_variances,
            estimator.external_m,
            self._present_target() or Target(lift=0.0),
            body.commanded_rad,
            body.lift,
            self.battery_v,
            int(Battery.LOW_POWER if is_low else Battery.BATTERY),
            int(self.bits),
            self.memories.tester.errors,
        )

    def reports(self) -> Iterator[bytes]:
        """Return the reports of the log that are due, and what the drone tells without a request."""
        yield from self._unasked
        self._unasked.clear()
        if self.log.is_due(self.time_s):
            yield from self.log.reports(self.reading, self.time_s, self.time_s - self._booted_s)

    # -- received packets

    def receive(self, packet: bytes) -> Reaction:
        """Process a packet. A malformed one has no effect and no answer."""
        if p.is_null(packet):
            return answer(Port.LINK, 3, b"", "poll")
        try:
            port, channel, data = p.decode(packet)
            if packets.key_of(port, channel) not in packets.PACKETS:
                return Reaction("other")
            match port:
                case Port.SETPOINT:
                    return self._set(data) if channel == 0 else self._yield(data)
                case Port.RPYT:
                    return self._set_old(data)
                case Port.HIGH_LEVEL:
                    return self._order(data)
                case Port.SUPERVISOR:
                    return self._ask_supervisor(data) if channel == 0 else self._command_supervisor(data)
                case Port.LOCALIZATION:
                    return self._localize(channel, data)
                case Port.MEMORY:
                    return self._remember(channel, data)
                case Port.LOG:
                    return self.log.receive(channel, data, self.time_s)
                case Port.PARAMETERS:
                    return self.parameters.receive(channel, data)
                case Port.PLATFORM:
                    return self._command_platform(data) if channel == 0 else self._identify(data)
                case Port.LINK:
                    return answer(Port.LINK, channel, p.NAME.ljust(30, b"\0") if channel == 1 else data)
        except (MalformedFrame, struct.error, IndexError, ValueError):
            return Reaction("garbled")
        return Reaction("other")

    # -- commanders

    def _set(self, data: bytes) -> Reaction:
        kind = data[0]
        if kind not in packets.SETPOINTS:
            return Reaction("other")
        if kind == Setpoint.STOP:
            return self._follow(None, "safe", "limp")
        target = setpoints.parse_setpoint(kind, data[1:])
        still = kind == Setpoint.HOVER and data[1:13] == struct.pack("<fff", -0.0, 0.0, 0.0)
        return self._follow(target, "safe", "hold") if still else self._follow(target, "setpoint")

    def _set_old(self, data: bytes) -> Reaction:
        target, self._thrust_locked = setpoints.parse_rpyt(data, self._thrust_locked, self.parameters.values)
        return self._follow(target, "setpoint")

    def _follow(self, target: Target | None, kind: str, safe_state: str | None = None) -> Reaction:
        self._setpoint, self._setpoint_s = target, self.time_s
        self.planner.stop()
        return Reaction(kind, (), safe_state)

    def _yield(self, data: bytes) -> Reaction:
        if data[0] != 0:
            return Reaction("other")
        self._setpoint = self._setpoint_s = None
        return Reaction("yield")

    def _order(self, data: bytes) -> Reaction:
        kind = data[0]
        if kind not in packets.ORDERS:
            return Reaction("other", _status(data, packets.ENOEXEC))
        blocked = not self.supervisor.motors_may_turn
        status = self.planner.obey(kind, data[1:], self.estimator.moment, self.time_s, blocked)
        if kind == HighLevel.STOP:
            return Reaction("safe", _status(data, status), "limp")
        if kind in _LANDS:
            return Reaction("safe", _status(data, status), "land")
        return Reaction("read" if kind in _SETTINGS else "setpoint", _status(data, status))

    # -- supervisor

    def _ask_supervisor(self, data: bytes) -> Reaction:
        bits = self.reading.bits
        match data[0]:
            case 0x0C:
                value = struct.pack("<H", bits)
            case number if 1 <= number <= 11:
                value = bytes((bits >> number - 1 & 1,))
            case _:
                return Reaction("other")
        return answer(Port.SUPERVISOR, 0, bytes((0x80 | data[0],)) + value)

    def _command_supervisor(self, data: bytes) -> Reaction:
        match data[0]:
            case Order.ARM:
                reply = bytes((0x81, self.supervisor.arm(bool(data[1])), self.supervisor.armed))
                return answer(Port.SUPERVISOR, 1, reply, "arm" if data[1] else "disarm")
            case Order.RECOVER:
                reply = bytes((0x82, self.supervisor.recover(), not self.supervisor.crashed))
                return answer(Port.SUPERVISOR, 1, reply, "recover")
            case Order.EMERGENCY_STOP:
                return self._stop_in_emergency()
            case Order.KEEP_ALIVE:
                return self._keep_alive()
        return Reaction("other")

    def _command_platform(self, data: bytes) -> Reaction:
        """Obey a client that does not know the port of the supervisor."""
        if data[0] not in (Order.ARM, Order.RECOVER):
            return Reaction("other")
        reaction = self._command_supervisor(data)
        ((_, _, reply),) = (p.decode(one) for one in reaction.replies)
        return answer(Port.PLATFORM, 0, bytes((data[0],)) + reply[1:], reaction.kind)

    def _stop_in_emergency(self) -> Reaction:
        self.supervisor.stop_in_emergency()
        return Reaction("safe", (), "off")

    def _keep_alive(self) -> Reaction:
        self.supervisor.keep_alive(self.time_s)
        return Reaction("poll")

    # -- estimator

    def _localize(self, channel: int, data: bytes) -> Reaction:
        if channel == 0:
            self.estimator.correct(_place(data))
            return Reaction("setpoint")
        if channel == 2:
            for drone, *place in struct.iter_unpack("<B3h", data):
                if drone == ADDRESS:
                    self.estimator.correct((place[0] / 1e3, place[1] / 1e3, place[2] / 1e3))
            return Reaction("setpoint" if data else "garbled")
        match data[0]:
            case packets.EMERGENCY_STOP:
                return self._stop_in_emergency()
            case packets.KEEP_ALIVE:
                return self._keep_alive()
            case packets.EXTERNAL_POSE:
                qx, qy, qz, qw = struct.unpack("<4f", data[13:])
                self.estimator.correct(_place(data[1:13]), setpoints.yaw_of(qw, qx, qy, qz))
            case packets.EXTERNAL_POSES if len(data) > 1:
                for drone, x, y, z, packed in struct.iter_unpack("<B3hI", data[1:]):
                    if drone == ADDRESS:
                        yaw_rad = setpoints.yaw_of(*setpoints.unpack_quaternion(packed))
                        self.estimator.correct((x / 1e3, y / 1e3, z / 1e3), yaw_rad)
            case _:
                return Reaction("other")
        return Reaction("setpoint")

    def _take_parameter(self, name: str) -> None:
        """Carry out the effect of a new value."""
        values = self.parameters.values
        if name == _RESET and values[name]:
            place = [values[f"kalman.initial{axis}"] for axis in "XYZ"]
            self.estimator.reset((place[0], place[1], place[2]), values["kalman.initialYaw"])
            values[name] = 0
            self._unasked.append(self.parameters.updated(name))
        elif name.startswith(_POSITION_GROUP):
            axis, field = "xyz".find(name[len(_POSITION_GROUP)]), name[len(_POSITION_GROUP) + 1 :]
            rows = {"Kp": self.body.gains.proportional, "VelMax": self.body.gains.most_m_s}
            if axis >= 0 and field in rows:
                rows[field][axis] = values[name]
        elif name == "memTst.resetW" and values[name]:
            self.memories.tester.errors = 0

    # -- tables

    def _remember(self, channel: int, data: bytes) -> Reaction:
        if channel == 0 and data[0] == 1:
            return answer(Port.MEMORY, 0, bytes((1, len(self.memories))))
        if channel == 0 and data[0] != 2:
            return Reaction("other")
        if data[1 if channel == 0 else 0] >= len(self.memories):
            # The firmware checks this with an assertion.
            self._note("assertion failed: restarted")
            self.boot()
            return Reaction("garbled")
        if channel == 0:
            return answer(Port.MEMORY, 0, data[:2] + self.memories.describe(data[1]))
        number, address = struct.unpack("<BI", data[:5])
        if channel == 1:
            content = self.memories.read(number, address, data[5])
            status = packets.EIO if content is None else 0
            return answer(Port.MEMORY, 1, data[:5] + bytes((status,)) + (content or b""))
        status = 0 if self.memories.write(number, address, data[5:]) else packets.EIO
        return answer(Port.MEMORY, 2, data[:5] + bytes((status,)))

    def _identify(self, data: bytes) -> Reaction:
        match data[0]:
            case 0:
                return answer(Port.PLATFORM, 1, b"\0" + struct.pack("<i", self._protocol))
            case 1:
                return answer(Port.PLATFORM, 1, b"\1" + VERSION + b"\0")
            case 2:
                return answer(Port.PLATFORM, 1, b"\2" + DEVICE + b"\0")
        return Reaction("other")


def _status(data: bytes, status: int) -> tuple[bytes, ...]:
    """Encode the high-level commander's answer to an order: the first three bytes of the order, and a status."""
    return (p.encode(Port.HIGH_LEVEL, 0, data[:3].ljust(3, b"\0") + bytes((status,))),)


def _place(data: bytes) -> tuple[float, float, float]:
    x, y, z = struct.unpack("<fff", data)
    if not all(map(math.isfinite, (x, y, z))):
        raise MalformedFrame("a position with a number that is not finite")
    return x, y, z


__all__ = ["ADDRESS", "Firmware"]
