"""The ur5e of the explorer, commanded by the driver's control script.

The twin's controller runs the text that the driver uploads, line by line, and an RTDE connection writes
its registers. The arm is energised late, as with ur-rtde (``upload_arm``): the script waits in buffers,
and is then compiled.
"""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from typing import Any, ClassVar

from strands_actors.contract.loading import load

from .robot_model import Seam
from .tcp_network import Piece, SimStream
from .upload_arm import ON_ITS_WAY_S, SampleClient, UploadArm, plain, protocol
from .world import World

script: Any = import_module("strands_actors.drivers.ur.script")
script_control: Any = import_module("strands_actors.drivers.ur.script_control")
Script: Any = load("strands_actors.drivers.ur.twin.urscript:Script")


class ScriptArm(UploadArm):
    OPTIONS: ClassVar[Mapping[str, Any]] = {"control": "script"}
    PROGRAM: ClassVar[type] = Script

    def __init__(self, world: World, robot: str) -> None:
        super().__init__(world, robot.removesuffix("_script"))

    def seams(self) -> tuple[Seam, ...]:
        return (plain, "open_tcp", self.network.open), (script_control, "open_tcp", self.network.open)

    def _accept(self, stream: SimStream) -> Any:
        if stream.port == protocol.RTDE_PORT:
            return _RegisterClient(self, stream)
        return super()._accept(stream)

    def take_script(self, text: bytes, piece: Piece) -> None:
        """Read an uploaded program late, and a stop at once."""
        late_s = ON_ITS_WAY_S * self.rng.random() if text.startswith(b"def ") else 0.0
        self.world.after(late_s, lambda: super(ScriptArm, self).take_script(text, piece))


class _RegisterClient(SampleClient):
    """The robot's end of an RTDE client that may write registers. Several clients may do so here. In tests
    with processes, the twin's server allows one writer for each register."""

    KINDS: Mapping[int, tuple[str, str]] = {
        script.Order.SERVO: ("setpoint", ""),
        script.Order.HOLD: ("safe", "hold"),
        script.Order.END: ("safe", "stop"),
    }
    _inputs: Any = None

    def _answer(self, packet: Any) -> bytes | None:
        match packet.kind:
            case protocol.Kind.INPUTS:
                names = packet.payload.decode().split(",")
                types = ["DOUBLE" if "double" in name else "INT32" for name in names]
                self._inputs = protocol.Recipe(1, names, types)
                return b"\x01" + ",".join(types).encode()
            case protocol.Kind.DATA:
                return None
        return super()._answer(packet)

    def _take(self, packet: Any, piece: Piece) -> None:
        if packet.kind != protocol.Kind.DATA:
            return
        values = self._inputs.unpack(packet.payload)
        ran, order = bool(self._arm.following), values[script.ORDER]
        self._arm.controller.write(values)
        if ran and order in self.KINDS:
            named = script.TARGETS if order == script.Order.SERVO else ()
            self._arm.log(*self.KINDS[order], piece, dict(enumerate((values[name] for name in named), 1)))
