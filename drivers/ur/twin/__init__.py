"""Simulate a UR controller with its arm (a "twin"): RTDE, script ports and dashboard. MuJoCo simulates the arm.

A test controls a simulated robot by lines of text. This robot accepts the lines of every twin, and also ``safety
MODE``, ``mode MODE`` and ``remote yes|no``. The names of the modes are in ``protocol.SafetyMode`` and
``protocol.RobotMode``.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from functools import cache
from typing import Annotated, Any, Unpack

import trio

from strands_actors.contract.loading import load
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
from strands_actors.drivers.ur.arms import JOINTS, Gripper, arm_of

from . import state_packets
from .body import URBody
from .controller import TICK_HZ, Controller
from .model import MOUNTED
from .outputs import Sample
from .requests import MODELLED
from .rtde import RtdeServer
from .text_ports import Dashboard, ScriptPort

STATE_HZ = 10.0
"""Rate in Hz at which the ports 30001 and 30002 send the state. The real-time port (30003) sends it in every
tick."""


class URTwinOptions(HostOption, frozen=True):
    """The options of a simulated UR controller. Its TCP ports are those of a real controller."""

    program_start_s: Annotated[float, option("seconds from a program's text to its first line", ge=0)] = 0.05
    program_load_s: Annotated[
        float, option("seconds before those in which a program's text is loaded, and no stop ends it", ge=0)
    ] = 0.0
    gripper: Annotated[
        Gripper | None, option("a Robotiq on its flange, which serves Modbus on port 502 of the same address")
    ] = None


class Machine:
    """Set faults of the simulated robot, and restart it."""

    def __init__(self, controller: Controller, faults: Faults) -> None:
        self.controller = controller
        self.faults = faults

    def set_fault(self, fault: Fault, unit: int | None) -> None:
        """Inject a fault.

        Args:
            fault: The fault.
            unit: 1 to 6 for a joint, which can only get stuck. None for a fault of the samples.
        """
        if unit is None:
            self.faults.set(fault)
        elif fault in (Fault.OK, Fault.STUCK) and 1 <= unit <= len(JOINTS):
            self.controller.plant.set_stuck(unit - 1, fault is Fault.STUCK)
        else:
            raise ValueError(f"a joint, 1 to {len(JOINTS)}, can be ok or stuck, not {fault}")

    def power_cycle(self) -> None:
        self.controller.reset()


class URServer(TcpServer):
    """Serve the ports of one simulated controller, and call its tick 500 times a second."""

    def __init__(self, robot: str, log: WireLog, chosen: URTwinOptions) -> None:
        def on_event(kind: str, text: str) -> None:
            log.write(time.monotonic_ns(), "robot", [(kind, text.encode())])
            if text and self._is_ready:
                self._state.tell(state_packets.error_message(self.controller.uptime_s, text))

        self._is_ready = False  # True once the ports exist. The controller may report events before.

        gripper = chosen.gripper or ""
        self.controller = Controller(
            arm_of(robot), gripper=gripper, program_start_s=chosen.program_start_s, on_event=on_event
        )
        self._gripper: Any = load(f"{MOUNTED}:MountedGripper")(gripper, self.controller.plant) if gripper else None
        faults = Faults()
        self._rtde = RtdeServer(self.controller, faults)
        self._machine = Machine(self.controller, faults)
        self._body = URBody(self.controller)
        load_s = chosen.program_load_s
        greeting = state_packets.version_message()
        self._state = ScriptPort(self.controller, STATE_HZ, state_packets.state_message, greeting, load_s)
        self._realtime = ScriptPort(self.controller, TICK_HZ, state_packets.realtime_message, load_s=load_s)
        self._is_ready = True
        self._ticks = 0
        handlers = {
            p.RTDE_PORT: self._rtde.handle,
            p.DASHBOARD_PORT: Dashboard(self.controller, robot).handle,
            p.PRIMARY_PORT: self._state.handle,
            p.SECONDARY_PORT: self._state.handle,
            p.REALTIME_PORT: self._realtime.handle,
        }
        if self._gripper is not None:
            handlers |= self._gripper.handlers
        super().__init__(self._machine, handlers, log, chosen.host)

    @property
    def body(self) -> URBody:
        return self._body

    def set_fault(self, text: str) -> None:
        super().set_fault(text)
        if self._machine.faults.of(None) is Fault.OFF:
            self.unplug()

    def power_cycle(self) -> None:
        """Restart the controller. This closes every connection, and the arm's power is off afterwards."""
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
        if self._gripper is not None:
            self._gripper.pass_time()
        self.controller.tick()
        self._tell()

    def _tell(self) -> None:
        """Send all clients the data of this tick. Data that several clients receive is computed only once."""
        self._ticks += 1
        sample = cache(lambda: Sample(self.controller))
        self._rtde.push(self._ticks, time.monotonic(), sample)
        self._state.push(self._ticks, sample)
        self._realtime.push(self._ticks, sample)


def main(robot: str, *, options: Mapping[str, Any] | None = None, **start: Unpack[Start]) -> None:
    """Run the simulated controller of an arm of ``robots.toml`` until interrupted (see ``common.twin.run``)."""
    chosen = read_twin_options(robot, URTwinOptions, options)
    arm_of(robot)

    def build(wire_log: WireLog) -> URServer:
        return URServer(robot, wire_log, chosen)

    run_server(build, **start)


__all__ = ["MODELLED", "Machine", "URServer", "URTwinOptions", "main"]
