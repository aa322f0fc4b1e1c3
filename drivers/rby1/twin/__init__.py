"""Simulate an RB-Y1: its gRPC server, with a body in MuJoCo behind it.

Besides the control lines of every simulated robot it takes ``emergency-stop pressed``,
``emergency-stop released``, ``manager MINOR_FAULT``, ``manager MAJOR_FAULT`` and ``manager ok``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Unpack

import trio

from strands_actors.drivers.common.physics.controlled_body import SharedBody
from strands_actors.drivers.common.twin import (
    Fault,
    NetworkOptions,
    Port,
    Start,
    TcpServer,
    WireLog,
    read_twin_options,
    run_server,
)
from strands_actors.drivers.common.twin.grpc import GrpcHost
from strands_actors.drivers.rby1.protocol import PORT, Manager, ManagerOrder
from strands_actors.drivers.rby1.robots import TABLES

from .calls import MODELLED
from .controller import Controller
from .service import RBY1Service


class RBY1TwinOptions(NetworkOptions, frozen=True):
    port: Port = PORT


TICK_S = 0.004


class Machine:
    """Injects faults and events into the simulated robot."""

    def __init__(self, service: RBY1Service) -> None:
        self._service = service

    def set_fault(self, fault: Fault, unit: int | None) -> None:
        """Inject a fault.

        Args:
            fault: The fault.
            unit: 2 to 23 for one joint, which can only get stuck. None for all messages of the server.
        """
        plant = self._service.controller.plant
        if unit is None:
            self._service.faults.set(fault)
        elif fault in (Fault.OK, Fault.STUCK) and 0 <= unit - 2 < len(plant.joints):
            plant.set_stuck(unit - 2, fault is Fault.STUCK)
        else:
            raise ValueError(f"a joint (2 to {len(plant.joints) + 1}) can be ok or stuck, not {fault}")

    def power_cycle(self) -> None:
        self._service.controller.wake_up()


class RBY1Server(TcpServer):
    """Serve one simulated robot, and advance its time."""

    def __init__(self, controller: Controller, log: WireLog, host: str | None, port: int) -> None:
        self._service = RBY1Service(controller)
        self._grpc = GrpcHost(self._service)
        self._body = SharedBody(controller, lambda: controller.driven)
        super().__init__(Machine(self._service), {port: self._grpc.serve}, log, host)

    @property
    def body(self) -> SharedBody:
        return self._body

    def set_fault(self, text: str) -> None:
        was_off = self._service.faults.of(None) is Fault.OFF
        super().set_fault(text)
        is_off = self._service.faults.of(None) is Fault.OFF
        if is_off:
            self._service.controller.wake_up()
            self.unplug()
        elif was_off:
            self.plug()

    def power_cycle(self) -> None:
        """End every connection. The simulated robot then has no power on its motors."""
        super().power_cycle()
        self.unplug()
        self.plug()

    def order(self, words: Sequence[str]) -> bool:
        controller = self._service.controller
        match words:
            case ["emergency-stop", "pressed" | "released" as word]:
                controller.press(word == "pressed")
            case ["manager", "MINOR_FAULT" | "MAJOR_FAULT" as word]:
                controller.fail(Manager[word])
            case ["manager", "ok"]:
                controller.order_manager(ManagerOrder.RESET_FAULT)
            case _:
                return False
        return True

    async def serve(self) -> None:
        async with trio.open_nursery() as nursery:
            nursery.start_soon(super().serve)
            nursery.start_soon(self._frost.every, TICK_S, self._tick)

    def _tick(self) -> None:
        self._service.tick()
        self._grpc.flush()


def main(robot: str, *, options: Mapping[str, Any] | None = None, **start: Unpack[Start]) -> None:
    """Simulate a robot of ``robots.toml`` until interrupted (see ``common.twin.run``)."""
    twin_options = read_twin_options(robot, RBY1TwinOptions, options)
    controller = Controller(TABLES.table(robot))

    def build(wire_log: WireLog) -> RBY1Server:
        return RBY1Server(controller, wire_log, twin_options.host, twin_options.port)

    run_server(build, **start)


__all__ = ["MODELLED", "Machine", "RBY1Server", "RBY1TwinOptions", "main"]
