"""The robot's end of a UR's wires: RTDE, script ports, dashboard; MuJoCo behind them.

Besides the control lines of every twin it takes ``safety MODE``, ``mode MODE`` and ``remote
yes|no``, with the names of ``protocol.SafetyMode`` and ``protocol.RobotMode``.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from functools import cache
from typing import Annotated, Any, Unpack

import trio

from strands_actors.contract.options import option
from strands_actors.drivers.common.twin import (
    Fault,
    Faults,
    HostOption,
    Start,
    TcpServer,
    WireLog,
    read_twin_options,
    run_server,
)
from strands_actors.drivers.ur import protocol as p
from strands_actors.drivers.ur.arms import JOINTS, arm_of

from . import state_packets
from .body import URBody
from .controller import TICK_HZ, Controller
from .outputs import Sample
from .rtde import RtdeServer
from .text_ports import Dashboard, ScriptPort

STATE_HZ = 10.0
"""Rate of the state on 30001 and 30002. The real-time port sends it every tick."""


class URTwinOptions(HostOption, frozen=True):
    """The options of a twin. Its ports are fixed."""

    program_start_s: Annotated[float, option("seconds from a program's text to its first line", ge=0)] = 0.05
    program_load_s: Annotated[
        float, option("seconds before those in which a program's text is loaded, and no stop ends it", ge=0)
    ] = 0.0


class Machine:
    """The events that may happen to the robot."""

    def __init__(self, controller: Controller, faults: Faults) -> None:
        self.controller = controller
        self.faults = faults

    def set_fault(self, fault: Fault, unit: int | None) -> None:
        """``unit`` 1 to 6: a joint, which can only get stuck. None: the samples of the controller."""
        if unit is None:
            self.faults.set(fault)
        elif fault in (Fault.OK, Fault.STUCK) and 1 <= unit <= len(JOINTS):
            self.controller.plant.set_stuck(unit - 1, fault is Fault.STUCK)
        else:
            raise ValueError(f"a joint, 1 to {len(JOINTS)}, can be ok or stuck, not {fault}")

    def power_cycle(self) -> None:
        self.controller.reset()


class URServer(TcpServer):
    """Serves one controller at its ports, and makes its time pass."""

    def __init__(self, robot: str, log: WireLog, given: URTwinOptions) -> None:
        def on_event(kind: str, text: str) -> None:
            log.write(time.monotonic_ns(), "robot", [(kind, text.encode())])
            if text and self._told:
                self._state.tell(state_packets.error_message(self.controller.uptime_s, text))

        self._told = False  # the controller exists before its ports

        self.controller = Controller(arm_of(robot), program_start_s=given.program_start_s, on_event=on_event)
        faults = Faults()
        self._rtde = RtdeServer(self.controller, faults)
        self._machine = Machine(self.controller, faults)
        self._body = URBody(self.controller)
        load_s = given.program_load_s
        greeting = state_packets.version_message()
        self._state = ScriptPort(self.controller, STATE_HZ, state_packets.state_message, greeting, load_s)
        self._realtime = ScriptPort(self.controller, TICK_HZ, state_packets.realtime_message, load_s=load_s)
        self._told = True
        self._ticks = 0
        handlers = {
            p.RTDE_PORT: self._rtde.handle,
            p.DASHBOARD_PORT: Dashboard(self.controller, robot).handle,
            p.PRIMARY_PORT: self._state.handle,
            p.SECONDARY_PORT: self._state.handle,
            p.REALTIME_PORT: self._realtime.handle,
        }
        super().__init__(self._machine, handlers, log, given.host)

    @property
    def body(self) -> URBody:
        return self._body

    def set_fault(self, text: str) -> None:
        super().set_fault(text)
        if self._machine.faults.of(None) is Fault.OFF:
            self.unplug()

    def power_cycle(self) -> None:
        """Close every connection. The controller comes back with the arm's power off."""
        super().power_cycle()
        self.unplug()
        self.plug()

    def order(self, words: Sequence[str]) -> bool:
        match words:
            case ["safety", name] if name in p.SafetyMode.__members__:
                self.controller.set_safety(p.SafetyMode[name])
            case ["mode", name] if name in p.RobotMode.__members__:
                self.controller.set_mode(p.RobotMode[name])
            case ["remote", "yes" | "no" as word]:
                self.controller.remote = word == "yes"
            case _:
                return False
        return True

    async def serve(self) -> None:
        async with trio.open_nursery() as nursery:
            nursery.start_soon(super().serve)
            nursery.start_soon(self._frost.every, 1.0 / TICK_HZ, self._tick)

    def _tick(self) -> None:
        self.controller.tick()
        self._tell()

    def _tell(self) -> None:
        """Send all clients the data that is due. Data for several clients is computed once."""
        self._ticks += 1
        sample = cache(lambda: Sample(self.controller))
        self._rtde.push(self._ticks, time.monotonic(), sample)
        self._state.push(self._ticks, sample)
        self._realtime.push(self._ticks, sample)


def main(robot: str, *, options: Mapping[str, Any] | None = None, **start: Unpack[Start]) -> None:
    """Serve an arm of ``robots.toml`` until interrupted (see ``common.twin.run``)."""
    given = read_twin_options(robot, URTwinOptions, options)
    arm_of(robot)

    def build(wire_log: WireLog) -> URServer:
        return URServer(robot, wire_log, given)

    run_server(build, **start)
