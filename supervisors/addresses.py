"""Build the addresses of a robot's actors: ``strands/<robot>/actor/<path>``."""

from __future__ import annotations

from strands_actors.kernel.node import PREFIX


class Addresses:
    def __init__(self, robot: str) -> None:
        self._robot = robot
        self.gate = self.address("gate")
        self.watchdog = self.address("watchdog")
        self.transport = self.address("transport")
        self.guardian = self.address("guardian")
        self.safety = self.address("safety")
        self.commands = self.address("commands")
        self.gateway = self.address("gateway")
        self.gateway_stop = self.address("gateway/stop")
        self.telemetry = self.address("telemetry")
        self.root = self.address("root")
        self.tasks = self.address("tasks")
        self.policy = self.address("policy")
        self.standby = self.address("standby")

    def path(self, name: str) -> str:
        """Return the part of an address after ``actor/``, such as ``gate``. ``Node.cell`` starts an actor under
        this path."""
        return f"{self._robot}/actor/{name}"

    def introspection(self, process: str) -> str:
        """Return the path of the actor that describes one process. ``process`` is root, wire or policy."""
        return self.path(f"introspection/{process}")

    def instrument(self, process: str) -> str:
        """Return the path of the actor to which a recorder connects. ``process`` is the one that it records: root
        or wire."""
        return self.path(f"instrument/{process}")

    def address(self, name: str) -> str:
        return f"{PREFIX}/{self.path(name)}"


def of(robot: str) -> Addresses:
    return Addresses(robot)
