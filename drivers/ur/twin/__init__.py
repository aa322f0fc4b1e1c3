"""Simulate a UR controller with its arm (a "twin"): RTDE, script ports and dashboard. MuJoCo simulates the arm.

A test controls a simulated robot by lines of text. This robot accepts the lines of every twin, and also ``safety
MODE``, ``mode MODE`` and ``remote yes|no``. The names of the modes are in ``protocol.SafetyMode`` and
``protocol.RobotMode``.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from functools import cache
from typing import Annotated, Any

from strands_actors.contract.loading import load
from strands_actors.contract.options import option
from strands_actors.drivers.common.twin import (
    HostOption,
    TcpServer,
    TwinRobot,
    WireLog,
    main_of,
)
from strands_actors.drivers.ur import protocol as p
from strands_actors.drivers.ur.arms import JOINTS, MOUNTED, Gripper, arm_of

from . import state_packets
from .body import URBody
from .controller import TICK_HZ, Controller
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
        Gripper | None,
        option("a Robotiq on its flange, with the text port of its URCap, and Modbus on port 502"),
    ] = None
    gripper_driven: Annotated[bool, option("whether a simulation moves the gripper as an axis of the arm")] = True


class URTwin(TwinRobot):
    """One simulated controller with its ports. A joint has a number from 1 to 6. After a restart the arm's power is
    off."""

    PARTS = range(1, len(JOINTS) + 1)
    TICK_S = 1.0 / TICK_HZ
    RESTART_CUTS = True

    def __init__(self, robot: str, log: WireLog, chosen: URTwinOptions) -> None:
        def on_event(kind: str, text: str) -> None:
            log.write(time.monotonic_ns(), "robot", [(kind, text.encode())])
            if text and self._is_ready:
                self._state.tell(state_packets.error_message(self.controller.uptime_s, text))

        super().__init__()
        self._is_ready = False  # True once the ports exist. The controller may report events before.
        gripper = chosen.gripper or ""
        self.controller = Controller(
            arm_of(robot), gripper=gripper, program_start_s=chosen.program_start_s, on_event=on_event
        )
        self._gripper: Any = load(f"{MOUNTED}:MountedGripper")(gripper, self.controller.plant) if gripper else None
        arm = URBody(self.controller)
        drives = self._gripper is not None and chosen.gripper_driven
        self.body = load(f"{MOUNTED}:GrippingBody")(arm, self._gripper) if drives else arm
        self._rtde = RtdeServer(self.controller, self.faults)
        load_s = chosen.program_load_s
        greeting = state_packets.version_message()
        self._state = ScriptPort(self.controller, STATE_HZ, state_packets.state_message, greeting, load_s)
        self._realtime = ScriptPort(self.controller, TICK_HZ, state_packets.realtime_message, load_s=load_s)
        self._is_ready = True
        self._ticks = 0
        self.handlers = {
            p.RTDE_PORT: self._rtde.handle,
            p.DASHBOARD_PORT: Dashboard(self.controller, robot).handle,
            p.PRIMARY_PORT: self._state.handle,
            p.SECONDARY_PORT: self._state.handle,
            p.REALTIME_PORT: self._realtime.handle,
            **(self._gripper.handlers if self._gripper is not None else {}),
        }

    def jam(self, index: int, on: bool) -> None:
        self.controller.plant.set_stuck(index, on)

    def power_cycle(self) -> None:
        self.controller.reset()

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

    def tick(self) -> None:
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


def build(robot: str, options: URTwinOptions, log: WireLog) -> TcpServer:
    """Return the server of a robot of ``robots.toml``."""
    twin = URTwin(robot, log, options)
    return TcpServer(twin, twin.handlers, log, options.host)


main = main_of(URTwinOptions, build)

__all__ = ["MODELLED", "URTwin", "URTwinOptions", "build", "main"]
