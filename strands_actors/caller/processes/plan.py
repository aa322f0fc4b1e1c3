"""The ``Plan`` of a robot: the processes to start, and their settings."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from strands_actors.contract.cameras import CameraSettings
from strands_actors.contract.driver import Driver
from strands_actors.kernel.processes.limits import PolicyLimits
from strands_actors.surfaces.mesh.config import MeshConfig

from .twin_process import TwinProcess


@dataclass(frozen=True)
class Plan:
    """The checked arguments of ``Robot(...)``, with everything that a start needs.

    Attributes:
        robot: Name of the robot.
        tool_name: Id of the robot.
        driver_class: The driver.
        port: Port or address; empty for a simulated robot, or a robot of another host.
        transport: ``twin``, ``sim``, or a transport of the driver; None if ``port`` is used.
        options: Options of the driver.
        twin_process: The process that simulates the robot; None for hardware.
        owns_twin_process: True if ``cleanup`` ends ``twin_process``. False if the user started that simulation.
        data_config: Kept unchanged for code that builds a policy.
        mesh: Addresses and certificates of the mesh.
    """

    robot: str
    tool_name: str
    driver_class: type[Driver]
    port: str
    transport: str | None
    # The options may contain a password, so ``repr`` leaves them out.
    options: dict[str, Any] = field(repr=False)
    twin_process: TwinProcess | None = None
    owns_twin_process: bool = True
    data_config: Any = None
    mesh: MeshConfig = MeshConfig()  # noqa: RUF009  # frozen
    drill_age_s: float | None = None
    """Greatest age of the last stop drill. Without a younger drill, motion is refused. None: no limit."""
    host_address: str = ""
    """The address of another host that runs the robot; empty if this host does. ``mesh`` has it, too."""
    lifetime_s: float | None = None
    """Least lifetime in seconds of a setpoint of a policy or a motion."""
    cameras: tuple[CameraSettings, ...] = ()
    attached: bool = False
    """True if a host of this user keeps the robot, and this is a handle of it."""
    hosted: Mapping[str, Any] | None = None
    """If a host makes the plan: settings for the handles of its robot, as plain data. None for a script."""
    policy_limits: PolicyLimits = PolicyLimits()  # noqa: RUF009  # frozen
    """Limits of each process of a named policy."""
    parts: Mapping[str, Plan] = field(default_factory=dict)
    """The plan of each part of a robot that is made of other robots, by the part's name."""
    is_part: bool = False
    """True for such a part. The wire process of the whole robot commands it, as an attached program."""

    @property
    def is_simulated(self) -> bool:
        """True for a simulation, or a simulated robot (twin), that this program or the robot's host started. All
        parts of a robot of parts are then simulated."""
        if self.parts:
            return all(part.is_simulated for part in self.parts.values())
        return self.twin_process is not None or (self.attached and self.transport is not None)
