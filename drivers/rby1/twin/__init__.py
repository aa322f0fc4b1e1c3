"""Simulate an RB-Y1: its gRPC server, with a body in MuJoCo behind it.

Besides the control lines of every simulated robot it takes ``emergency-stop pressed``,
``emergency-stop released``, ``manager MINOR_FAULT``, ``manager MAJOR_FAULT`` and ``manager ok``.
"""

from __future__ import annotations

from collections.abc import Sequence

from strands_actors.drivers.common.physics.controlled_body import SharedBody
from strands_actors.drivers.common.twin import NetworkOptions, Port, TcpServer, TwinRobot, WireLog, main_of
from strands_actors.drivers.common.twin.grpc import GrpcHost
from strands_actors.drivers.rby1.protocol import PORT, Manager, ManagerOrder
from strands_actors.drivers.rby1.robots import TABLES

from .calls import MODELLED
from .controller import Controller
from .service import RBY1Service


class RBY1TwinOptions(NetworkOptions, frozen=True):
    port: Port = PORT


FIRST_JOINT = 2
"""The number of the first joint. The numbers before it are those of the wheels."""


class RBY1Twin(TwinRobot):
    """One simulated robot with its gRPC server. A joint has a number from 2 to 23. After a restart the motors have
    no power."""

    TICK_S = 0.004
    RESTART_CUTS = True

    def __init__(self, controller: Controller) -> None:
        super().__init__()
        self._service = RBY1Service(controller)
        self.faults = self._service.faults
        self._grpc = GrpcHost(self._service)
        self.controller = controller
        self.serve = self._grpc.serve
        self.body = SharedBody(controller, lambda: controller.driven)
        self.PARTS = range(FIRST_JOINT, FIRST_JOINT + len(controller.plant.joints))

    def jam(self, index: int, on: bool) -> None:
        self.controller.plant.set_stuck(index, on)

    def power_cycle(self) -> None:
        self.controller.wake_up()

    def tick(self) -> None:
        self._service.tick()
        self._grpc.flush()

    def order(self, words: Sequence[str]) -> bool:
        match words:
            case ["emergency-stop", "pressed" | "released" as word]:
                self.controller.press(word == "pressed")
            case ["manager", "MINOR_FAULT" | "MAJOR_FAULT" as word]:
                self.controller.fail(Manager[word])
            case ["manager", "ok"]:
                self.controller.order_manager(ManagerOrder.RESET_FAULT)
            case _:
                return False
        return True


def build(robot: str, options: RBY1TwinOptions, log: WireLog) -> TcpServer:
    """Return the server of a robot of ``robots.toml``."""
    twin = RBY1Twin(Controller(TABLES.table(robot)))
    return TcpServer(twin, {options.port: twin.serve}, log, options.host)


main = main_of(RBY1TwinOptions, build)

__all__ = ["MODELLED", "RBY1Twin", "RBY1TwinOptions", "build", "main"]
