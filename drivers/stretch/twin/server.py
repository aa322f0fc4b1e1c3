"""Serve all ports of one simulated robot together. A folder contains a port for each board, under the board's
device name.

All waiting bytes of all ports are read in one pass. Frames to different boards within a pass have no order, as
on a real robot. Setpoints are therefore logged before stops. Otherwise a setpoint that was sent before a stop
to another board could appear after it.
"""

from __future__ import annotations

import contextlib
import json
import shutil
import tempfile
import time
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import trio

from strands_actors.drivers.common.twin import PtyLine, TwinServer, WireLog
from strands_actors.drivers.common.twin.server import Conversation, Exchange
from strands_actors.drivers.stretch.config import PIMU
from strands_actors.drivers.stretch.driver import TWIN_PORT
from strands_actors.drivers.stretch.parameters import FILES
from strands_actors.drivers.stretch.protocol import State
from strands_actors.drivers.stretch.robots import nominal_of, robot_of
from strands_actors.drivers.stretch.safing import number_of

from .boards import ChainDecoder, DeviceDecoder, PimuDecoder, ReceivedFrame, StepperDecoder, WaccDecoder
from .body import StretchBody
from .world import GRIPPER, World

WACC_USB = "/dev/hello-wacc"
DEVICES = "/dev/"
ALERTS = {
    "low-battery": State.LOW_VOLTAGE,
    "tilted": State.OVER_TILT,
    "cliff": State.CLIFF,
    "high-current": State.HIGH_CURRENT,
}
"""Alerts of the power board, which set the runstop."""
FLEET_ID = "stretch-twin-0000"
TICK_S = 0.05
"""How often the simulation advances without requests."""


class StretchServer(TwinServer):
    """Serve the simulated robot. ``address`` is the folder of the ports. The folder disappears when the cables
    are pulled. The folder ``fleet`` beside it contains the robot's own YAML for clients that read it."""

    def __init__(self, world: World, log: WireLog, folder: str | None = None) -> None:
        super().__init__(world, log)
        self._world = world
        self._own = tempfile.mkdtemp(prefix="strands-twin-") if folder is None else None
        self._root = Path(folder or self._own or "")
        self._folder = self._root / TWIN_PORT
        self._body = StretchBody(world)
        decoders = decoders_of(world)
        self._decoders: dict[str, DeviceDecoder] = {name: decoder for name, (decoder, _) in decoders.items()}
        self._lines = {name: PtyLine(str(self._folder / name)) for name in decoders}
        self._conversations = {
            name: Conversation(_Deaf(), self._lines[name], log, self._frost, wire_time=has_wire_time)
            for name, (_, has_wire_time) in decoders.items()
        }
        self._write_fleet()

    @property
    def address(self) -> str:
        return str(self._folder)

    @property
    def body(self) -> StretchBody:
        return self._body

    def _write_fleet(self) -> None:
        """Write the robot's YAML as JSON, which is valid YAML."""
        world = self._world
        fleet = self._root / "fleet" / FLEET_ID
        fleet.mkdir(parents=True, exist_ok=True)
        table = robot_of(world.config.robot)
        about = {"model_name": table.model_name, "tool": world.parameters.tool, "serial_no": FLEET_ID}
        words = {**nominal_of(world.config.robot), "robot": {**about, "batch_name": "twin"}}
        for name, content in zip(FILES, (words, self._devices()), strict=True):
            (fleet / name).write_text(json.dumps(content, indent=1))

    def _devices(self) -> dict[str, Any]:
        def of(device: str) -> str:
            return str(self._folder / device.removeprefix(DEVICES))

        parameters = self._world.parameters
        servos = [(joint.key, chain.usb) for chain in self._world.config.chains for joint in chain.joints]
        servos.append((GRIPPER, parameters.wrist.usb))
        return {
            **{key: {"usb_name": of(usb)} for key, usb in servos},
            "lift": {"usb_name": of(parameters.lift.usb)},
            "arm": {"usb_name": of(parameters.arm.usb)},
            "base": {
                "usb_name_left_wheel": of(parameters.left.usb),
                "usb_name_right_wheel": of(parameters.right.usb),
            },
            "pimu": {"usb_name": of(parameters.pimu_usb)},
            "wacc": {"usb_name": of(WACC_USB)},
            "end_of_arm": {"usb_name": of(parameters.wrist.usb)},
            parameters.tool: {"usb_name": of(parameters.wrist.usb)},
            "head": {"usb_name": of(parameters.head.usb)},
        }

    # -- events

    def plug(self) -> None:
        self._folder.mkdir(exist_ok=True)
        for line in self._lines.values():
            line.plug()

    def unplug(self) -> None:
        for line in self._lines.values():
            line.unplug()
        with contextlib.suppress(FileNotFoundError):
            self._folder.rmdir()

    def order(self, words: Sequence[str]) -> bool:
        """Carry out a control line. Return False if it is unknown. JOINT is the name of a joint.

        ``runstop on|off``; ``low-battery on|off``, and in the same way ``tilted``, ``cliff`` and ``high-current``;
        ``homed JOINT on|off``; ``contact JOINT on|off``; ``unplug-board NAME`` and ``plug-board NAME``, with the
        name of the board's device.
        """
        match words:
            case ["runstop", "on" | "off" as how]:
                self._world.pass_time()
                self._world.set_runstop(how == "on")
            case [alert, "on" | "off" as how] if alert in ALERTS:
                self._world.pass_time()
                self._world.set_alert(ALERTS[alert], how == "on")
            case ["homed", joint, "on" | "off" as how]:
                self._world.set_homed(joint, how == "on")
            case ["contact", joint, "on" | "off" as how]:
                self._world.set_contact(joint, how == "on")
            case ["unplug-board", name] if name in self._lines:
                self._lines[name].unplug()
            case ["plug-board", name] if name in self._lines:
                self._lines[name].plug()
            case _:
                return False
        return True

    # -- serving

    def start(self, nursery: trio.Nursery) -> None:
        # The robot moves on while no client asks it anything.
        nursery.start_soon(self._frost.every, TICK_S, self.body.pass_time)
        for conversation in self._conversations.values():
            nursery.start_soon(conversation.serve_replies)
        for line in self._lines.values():
            nursery.start_soon(self._listen, line)

    async def _listen(self, line: PtyLine) -> None:
        while True:
            await line.readable()
            await self._frost.thawed()
            self._sweep()
            await trio.lowlevel.checkpoint()

    def _sweep(self) -> None:
        """Read all ports until no byte waits. A frame that was written before another frame of this pass is
        then in this pass, too."""
        t_ns = time.monotonic_ns()
        waiting: dict[str, deque[ReceivedFrame]] = {name: deque() for name in self._lines}
        again = True
        while again:
            again = False
            for name, line in self._lines.items():
                if data := line.take():
                    again = True
                    waiting[name].extend(self._decoders[name].frames(data, line.bits_per_s()))
        for name, frame in commands_first(waiting):
            self._conversations[name].handle_received(frame.act(), t_ns)

    def close(self) -> None:
        self.unplug()
        if self._own is not None:
            shutil.rmtree(self._own, ignore_errors=True)


def commands_first(waiting: Mapping[str, deque[ReceivedFrame]]) -> Iterator[tuple[str, ReceivedFrame]]:
    """Return the frames, those of each port in their order. Across ports, setpoints come before stops."""
    while names := [name for name, frames in waiting.items() if frames]:
        name = next((each for each in names if waiting[each][0].kind != "safe"), names[0])
        yield name, waiting[name].popleft()


class _Deaf:
    """Ignores the bytes of a port, because ``_sweep`` reads and decodes the bytes of all ports together."""

    def receive(self, data: bytes, bits_per_s: int | None) -> Iterator[Exchange]:
        return iter(())


def decoders_of(world: World) -> dict[str, tuple[DeviceDecoder, bool]]:
    """Return the receiver of each device by name, and True if its bytes take time on a serial line (over USB
    they do not)."""
    config, decoders = world.config, dict[str, tuple[DeviceDecoder, bool]]()
    for name, motor in world.steppers.items():
        decoders[_device(config.usb(name))] = (StepperDecoder(world, motor), False)
    decoders[_device(config.usb(PIMU))] = (PimuDecoder(world, number_of(PIMU)), False)
    decoders[_device(WACC_USB)] = (WaccDecoder(world), False)
    for chain, bus in zip(config.chains, world.chains, strict=True):
        driven = frozenset(joint.id for joint in chain.joints)
        decoders[_device(chain.usb)] = (ChainDecoder(world, bus, driven), True)
    return decoders


def _device(usb: str) -> str:
    return usb.removeprefix(DEVICES)
