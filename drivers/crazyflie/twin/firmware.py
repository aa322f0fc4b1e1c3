"""Simulate the firmware: commander, supervisor, high-level commander, log and parameters. It has no sockets.

The watchdog is that of the real firmware. Without a setpoint it levels out after 0.5 s, and cuts the motors
after 2 s. The high-level commander has no watchdog, and flies its plan to the end.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.drivers.crazyflie import protocol as p
from strands_actors.drivers.crazyflie.config import LANDING_M_S
from strands_actors.drivers.crazyflie.protocol import Battery, Bit, HighLevel, Order, Port, Setpoint

from . import packets
from .body import LONGEST_S, TIMESTEP_S, FlyingBody, Target
from .tables import LOG, LOG_LAYOUTS, PARAMETERS, READ_ONLY, Reading, checksum, packed

LEVEL_AFTER_S, CUT_AFTER_S = 0.5, 2.0
"""Timeouts of the firmware's commander."""
FLYING_S = 2.0
"""How long the drone counts as flying after its motors stopped [assumed]."""
AIRBORNE_M = 0.02
TUMBLED_RAD, TUMBLED_S = math.radians(70.0), 0.3
"""Tilt, and its duration, at which the drone counts as tumbled [assumed]."""
LOW_V = 3.2
USUAL_LANDING_M_S = 0.5
"""Mean speed of a landing without a given speed."""
REFUSED, BLOCKED = 1, 16
"""Status of the high-level commander. ``REFUSED``: not in this state of the planner (a landing during a landing, a
takeoff in flight). ``BLOCKED``: the supervisor does not permit a flight."""

LOG_BYTES = 26
HOVER_THRUST = 36000.0
"""In the firmware's units, of 65535 [assumed]."""


class Reaction(NamedTuple):
    """The effect of a packet: its kind for the packet log, the answers, and the safe state that it causes."""

    kind: str
    replies: tuple[bytes, ...] = ()
    safe_state: str | None = None


@dataclass
class Plan:
    """A flight of the high-level commander from one height to another."""

    from_m: float
    to_m: float
    began_s: float
    duration_s: float
    lands: bool

    @property
    def ends_s(self) -> float:
        return self.began_s + self.duration_s

    def target(self, now_s: float) -> Target:
        """Return the present setpoint of the plan. It follows a polynomial of degree 7 from rest to rest."""
        share = min(1.0, (now_s - self.began_s) / self.duration_s)
        passed = share**4 * (35 - 84 * share + 70 * share**2 - 20 * share**3)
        rate = 140 * (share * (1 - share)) ** 3 / self.duration_s
        rise = self.to_m - self.from_m
        return Target(z_m=self.from_m + rise * passed, vz_m_s=rise * rate)


@dataclass
class RunningBlock:
    # number of the variable in the table, and type in which it is sent
    variables: list[tuple[int, int]] = field(default_factory=list)
    period_s: float = 0.0  # 0 if the block is not started
    due_s: float = 0.0


class Firmware:
    def __init__(
        self,
        table: Mapping[str, Any],
        now_s: Callable[[], float],
        *,
        protocol: int = p.OLDEST,
        auto_arm: bool = False,
        note: Callable[[str], None] = lambda text: None,
    ) -> None:
        """Start the firmware. ``note`` is called with a text for each action of the watchdog or the supervisor."""
        self.body = FlyingBody(table)
        self._now_s = now_s
        self._protocol = protocol
        self._auto_arm = auto_arm
        self._note = note
        self._updated_s = now_s()
        self.battery_v = 4.0
        self.stuck: Reading | None = None  # the report that a log with the fault "stuck" repeats
        self.wrong_m = 0.0
        self.boot()

    def boot(self) -> None:
        """Restart the firmware as after switching the drone off and on. The drone stays where it is."""
        self._booted_s = self.time_s
        self.armed = self._auto_arm
        self.locked = self.tumbled = self.crashed = False
        self._setpoint: Target | None = None
        self._setpoint_s = 0.0
        self._plan: Plan | None = None  # None while no flight is planned
        self._planned_until_s = -math.inf
        self._flew_s = -math.inf
        self._tipped_s = 0.0
        self._levelled = False
        self.blocks: dict[int, RunningBlock] = {}
        self.parameters = [parameter.value for parameter in PARAMETERS]
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
        blocked = not (self.may_fly or self.simulated)
        if self._plan is not None and (blocked or (self._plan.lands and self.time_s >= self._plan.ends_s)):
            self._plan = None
        self.body.target = self._present_target()
        self.body.step()
        self._supervise()

    def fly(self, target: Target | None) -> None:
        """Obey a setpoint of a local simulation, in the place of a client; None switches the motors off."""
        self._simulated, self._plan = target, None

    def descend(self) -> None:
        """Land for a local simulation, in the place of a client."""
        if self._simulated is not None:
            self._simulated = None
            self._begin(0.0, self.body.xyz_m[2] / LANDING_M_S, lands=True)

    def _begin(self, to_m: float, duration_s: float, lands: bool) -> None:
        """Start a flight of the high-level commander to a height."""
        plan = Plan(self._planned_m(), to_m, self.time_s, max(duration_s, TIMESTEP_S), lands)
        self._plan, self._planned_until_s = plan, plan.ends_s

    def _planned_m(self) -> float:
        """Return the height at which a new plan starts: the present height of a running plan, or else the
        drone's height."""
        planned = None if self._plan is None else self._plan.target(self.time_s).z_m
        return max(0.0, self.body.xyz_m[2]) if planned is None else planned

    def _present_target(self) -> Target | None:
        planned = None if self._plan is None else self._plan.target(self.time_s)
        if self.simulated:
            return planned or self._simulated
        if not self.may_fly:
            return None
        if self._setpoint is not None:
            age_s = self.time_s - self._setpoint_s
            if age_s > CUT_AFTER_S:
                self._setpoint = self._plan = None
                self._note("watchdog: motors off")
                return None
            if age_s > LEVEL_AFTER_S:
                if not self._levelled:
                    self._levelled = True
                    self._note("watchdog: level")
                return self._setpoint._replace(level=True, wz_rad_s=0.0)
            return self._setpoint
        return planned

    def _supervise(self) -> None:
        if self.motors_on and self.body.xyz_m[2] > AIRBORNE_M:
            self._flew_s = self.time_s
        self._tipped_s = self._tipped_s + TIMESTEP_S if self.body.tilt_rad > TUMBLED_RAD else 0.0
        tumbled = self._tipped_s >= TUMBLED_S
        if tumbled and not self.tumbled:
            self.crashed = self.crashed or self.flying
            self._note("supervisor: tumbled")
        self.tumbled = tumbled

    # -- reports

    @property
    def flying(self) -> bool:
        return self.time_s - self._flew_s < FLYING_S

    @property
    def sound(self) -> bool:
        return not (self.locked or self.tumbled or self.crashed)

    @property
    def may_fly(self) -> bool:
        return self.armed and self.sound

    @property
    def bits(self) -> Bit:
        flags = {
            Bit.CAN_BE_ARMED: self.sound,
            Bit.ARMED: self.armed,
            Bit.AUTO_ARMED: self._auto_arm,
            Bit.CAN_FLY: self.may_fly,
            Bit.FLYING: self.flying,
            Bit.TUMBLED: self.tumbled,
            Bit.LOCKED: self.locked,
            Bit.CRASHED: self.crashed,
            # This flag is set even while the drone obeys a setpoint instead of the plan.
            Bit.HIGH_LEVEL_ACTIVE: self._plan is not None,
            Bit.TRAJECTORY_FINISHED: self.time_s >= self._planned_until_s,
        }
        return Bit(sum(bit for bit, on in flags.items() if on))

    @property
    def reading(self) -> Reading:
        if self.stuck is not None:
            return self.stuck
        body = self.body
        x, y, z = body.xyz_m
        roll, pitch, yaw = (math.degrees(angle) for angle in body.rpy_rad)
        state = Battery.LOW_POWER if self.battery_v < LOW_V else Battery.BATTERY
        return Reading(
            (x, y, z + self.wrong_m),
            body.velocity_m_s,
            (roll, pitch, yaw),
            math.degrees(body.wz_rad_s),
            self.battery_v,
            int(state),
            int(self.bits),
            HOVER_THRUST if self.motors_on else 0.0,
        )

    def reports(self) -> Iterator[bytes]:
        """Return the reports of the log that are due."""
        for number, block in self.blocks.items():
            if block.period_s and self.time_s >= block.due_s:
                block.due_s = max(block.due_s + block.period_s, self.time_s)
                reading = self.reading
                values = (packed(LOG_LAYOUTS[code], LOG[index].read(reading)) for index, code in block.variables)
                stamp_ms = round((self.time_s - self._booted_s) * 1e3) % p.STAMP_WRAP_MS
                head = bytes((number,)) + stamp_ms.to_bytes(3, "little")
                yield p.encode(Port.LOG, 2, head + b"".join(values))

    # -- received packets

    def receive(self, packet: bytes) -> Reaction:
        """Process a packet. A malformed one has no effect and no answer."""
        if p.is_null(packet):
            return Reaction("poll", (p.encode(Port.LINK, 3),))
        try:
            port, channel, data = p.decode(packet)
            if packets.key_of(port, channel) not in packets.PACKETS:
                return Reaction("other")
            match port, channel:
                case Port.SETPOINT, 0:
                    return self._set(data)
                case Port.SETPOINT, 1:
                    self._setpoint = None
                    return Reaction("yield")
                case Port.HIGH_LEVEL, 0:
                    return self._high_level(data)
                case Port.RPYT, 0:
                    struct.unpack("<fffH", data)
                    return self._follow(Target(level=True), "setpoint")
                case Port.SUPERVISOR, _:
                    return self._supervisor(channel, data)
                case Port.LOCALIZATION, 1 if data[:1] == b"\x03":
                    return self._lock()
                case Port.LINK, 1:
                    return self._reply(Port.LINK, 1, p.NAME.ljust(30, b"\0"))
                case Port.LINK, 0:
                    return self._reply(Port.LINK, 0, data)
                case Port.PLATFORM, 1 if data[:1] == b"\0":
                    return self._reply(Port.PLATFORM, 1, bytes((0, self._protocol)))
                case Port.PLATFORM, 1 if data[:1] == b"\1":
                    return self._reply(Port.PLATFORM, 1, b"\1twin\0")
                case Port.MEMORY, _:
                    return self._memory(channel, data)
                case Port.LOG, _:
                    return self._log(channel, data)
                case Port.PARAMETERS, _:
                    return self._parameters(channel, data)
        except (MalformedFrame, struct.error, IndexError, ValueError):
            return Reaction("garbled")
        return Reaction("other")

    def _reply(self, port: int, channel: int, data: bytes, kind: str = "read") -> Reaction:
        return Reaction(kind, (p.encode(port, channel, data),))

    def _set(self, data: bytes) -> Reaction:
        if data[0] not in packets.SETPOINTS:
            return Reaction("other")
        match data[0]:
            case Setpoint.STOP:
                self._setpoint = self._plan = None
                return Reaction("safe", (), "limp")
            case Setpoint.HOVER:
                vx, vy, turn, z = struct.unpack("<ffff", data[1:])
                target = Target(vx, vy, 0.0, math.radians(turn), max(0.0, z), world=False)
                still = (math.copysign(1.0, vx), vx, vy, turn) == (-1.0, 0.0, 0.0, 0.0)
                return self._follow(target, "safe", "hold") if still else self._follow(target, "setpoint")
            case Setpoint.VELOCITY_WORLD:
                vx, vy, vz, turn = struct.unpack("<ffff", data[1:])
                return self._follow(Target(vx, vy, vz, math.radians(turn)), "setpoint")
        return Reaction("other")

    def _follow(self, target: Target, kind: str, safe_state: str | None = None) -> Reaction:
        self._setpoint, self._setpoint_s, self._levelled = target, self.time_s, False
        self._plan = None
        return Reaction(kind, (), safe_state)

    def _high_level(self, data: bytes) -> Reaction:
        height_m = self._planned_m()
        if data[0] not in packets.ORDERS:
            return Reaction("other", _answer(data, packets.ENOEXEC))
        match data[0]:
            case HighLevel.STOP:
                self._plan = None
                return Reaction("safe", _answer(data, 0), "limp")
            case HighLevel.TAKEOFF | HighLevel.LAND:
                _, to_m, _, _, duration_s = struct.unpack("<Bff?f", data[1:])
            case _:  # LAND_WITH_VELOCITY, the last one of the table
                _, to_m, relative, _, _, mean_m_s = struct.unpack("<Bf?f?f", data[1:])
                to_m = height_m - to_m if relative else to_m
                duration_s = abs(to_m - height_m) / (mean_m_s if mean_m_s > 0 else USUAL_LANDING_M_S)
        if not math.isfinite(to_m) or not 0 <= duration_s < 60:
            return Reaction("garbled")
        lands = data[0] != HighLevel.TAKEOFF
        status = 0
        if not self.may_fly:
            status = BLOCKED
        elif self._plan is not None and (self._plan.lands or not lands):
            status = REFUSED
        else:
            self._begin(to_m, duration_s, lands)
        answer = _answer(data, status)
        return Reaction("safe", answer, "land") if lands else Reaction("setpoint", answer)

    def _supervisor(self, channel: int, data: bytes) -> Reaction:
        match channel, data[0]:
            case 0, 0x0C:
                return self._reply(Port.SUPERVISOR, 0, b"\x8c" + struct.pack("<H", self.reading.bits))
            case 1, Order.ARM:
                arms = bool(data[1])
                done = not arms or Bit.CAN_BE_ARMED in self.bits
                self.armed = arms if done else self.armed
                answer = bytes((0x81, done, self.armed))
                return self._reply(Port.SUPERVISOR, 1, answer, "arm" if arms else "disarm")
            case 1, Order.RECOVER:
                self.crashed = self.crashed and self.tumbled
                return self._reply(Port.SUPERVISOR, 1, bytes((0x82, 1, not self.crashed)), "recover")
            case 1, Order.EMERGENCY_STOP:
                return self._lock()
        return Reaction("other")

    def _lock(self) -> Reaction:
        self.locked = True
        self._setpoint = self._plan = None
        return Reaction("safe", (), "off")

    # -- tables

    def _memory(self, channel: int, data: bytes) -> Reaction:
        """Answer as a drone without memories."""
        match channel, data[0]:
            case 0, 1:
                return self._reply(Port.MEMORY, 0, b"\1\0")
            case 0, 2:
                no_memory = bytes(1 + 4 + 8)  # type, size, and serial number
                return self._reply(Port.MEMORY, 0, data[:2] + no_memory)
            case 1 | 2, _:
                return self._reply(Port.MEMORY, channel, data[:5].ljust(5, b"\0") + bytes((packets.EIO,)))
        return Reaction("other")

    def _log(self, channel: int, data: bytes) -> Reaction:
        command = data[0]
        if channel == 0 and command == 3:
            info = struct.pack("<BHIBB", 3, len(LOG), checksum(LOG), 16, 128)
            return self._reply(Port.LOG, 0, info)
        if channel == 0 and command == 2:
            index = struct.unpack("<H", data[1:3])[0]
            variable = LOG[index]
            names = f"{variable.group}\0{variable.name}\0".encode()
            return self._reply(Port.LOG, 0, data[:3] + bytes((variable.type_code,)) + names)
        if channel != 1:
            return Reaction("other")
        if command == 5:
            self.blocks.clear()
            return self._reply(Port.LOG, 1, b"\5\0\0")
        return self._reply(Port.LOG, 1, bytes((command, data[1], self._change_block(command, data))))

    def _change_block(self, command: int, data: bytes) -> int:
        """Create, start, stop or delete a log block. Return an errno; 0 for success."""
        number, block = data[1], self.blocks.get(data[1])
        if command == 6:
            if block is not None:
                return packets.EEXIST
            items = [struct.unpack("<BH", data[index : index + 3]) for index in range(2, len(data), 3)]
            variables = [(index, type_code & 0x0F) for type_code, index in items]
            if any(index >= len(LOG) or type_code not in LOG_LAYOUTS for index, type_code in variables):
                return packets.ENOENT
            if sum(struct.calcsize(LOG_LAYOUTS[type_code]) for _, type_code in variables) > LOG_BYTES:
                return packets.E2BIG
            self.blocks[number] = RunningBlock(variables)
            return 0
        if command not in (2, 3, 4):
            return packets.ENOEXEC
        if block is None:
            return packets.ENOENT
        if command == 3:
            block.period_s, block.due_s = data[2] / 100, self.time_s
        elif command == 4:
            block.period_s = 0.0
        else:
            del self.blocks[number]
        return 0

    def _parameters(self, channel: int, data: bytes) -> Reaction:
        if channel == 0 and data[0] == 3:
            info = struct.pack("<BHI", 3, len(PARAMETERS), checksum(PARAMETERS))
            return self._reply(Port.PARAMETERS, 0, info)
        if channel == 0 and data[0] == 2:
            parameter = PARAMETERS[struct.unpack("<H", data[1:3])[0]]
            names = f"{parameter.group}\0{parameter.name}\0".encode()
            return self._reply(Port.PARAMETERS, 0, data[:3] + bytes((parameter.type_code,)) + names)
        if channel not in (1, 2):
            return Reaction("other")
        index = struct.unpack("<H", data[:2])[0]
        if index >= len(PARAMETERS):
            return self._reply(Port.PARAMETERS, channel, data[:2] + bytes((packets.ENOENT,)))
        layout = PARAMETERS[index].layout
        if channel == 2 and PARAMETERS[index].type_code & READ_ONLY:
            return Reaction("other")  # The firmware does not answer.
        if channel == 1:
            value = packed(layout, self.parameters[index])
            return self._reply(Port.PARAMETERS, 1, data[:2] + b"\0" + value)
        self.parameters[index] = struct.unpack(layout, data[2:])[0]
        return self._reply(Port.PARAMETERS, 2, data)


def _answer(data: bytes, status: int) -> tuple[bytes, ...]:
    """Encode the high-level commander's answer to an order: the first three bytes of the order, and a status."""
    return (p.encode(Port.HIGH_LEVEL, 0, data[:3].ljust(3, b"\0") + bytes((status,))),)
