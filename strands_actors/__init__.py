"""Control robots, each as a supervised tree of actors.

    from strands_actors import Robot

    arm = Robot("so101", mode="real", transport="twin")  # a simulated arm; with port= a real one
    arm.connect_eagerly()
    arm.send_action({"shoulder_pan": 10.0})
    arm.cleanup()

``Robot``             make the object that controls one robot, real (``RealRobot``) or simulated (``SimRobot``)
``open_robot``        the same for a trio program (``AsyncRobot``)
``Policy``            base class of a policy (a program that returns actions); ``create_policy`` makes
                      one by name, ``register_policy`` adds a name
``Teleoperator``      a leader that controls a robot
``record``, ``read``, ``replay``  record a robot, read a recording, repeat its decisions from the recorded inputs
``record_dataset``, ``replay_episode``  episodes in LeRobot's format
``get_peers``, ``tell``, ``broadcast``, ``estop``, ``resume``  robots on the mesh (the network between robots)
``fleet``             a tool for an agent, for all robots of the mesh; ``ask_on_console`` asks a person to
                      approve what an agent requests
``list_robots``, ``list_driver_coverage``  names of robots, and the drivers that exist for each

A name is loaded at its first use. If a function needs a package that is not installed, calling it
raises an error that names the package.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from .version import __version__

if TYPE_CHECKING:
    from .caller.handle.robot import AsyncRobot, RealRobot, Robot, SimRobot, open_robot
    from .drivers import (
        HardwareDriver,
        list_driver_coverage,
        list_native_drivers,
        list_robots,
        register_native_driver,
        register_robot,
    )
    from .policies import MockPolicy, Policy, create_policy, register_policy
    from .surfaces.agents.asking import ask_on_console
    from .surfaces.agents.fleet import fleet
    from .surfaces.dataset import record_dataset, replay_episode
    from .surfaces.mesh import (
        TLS,
        Access,
        MeshConfig,
        broadcast,
        control,
        estop,
        estop_button,
        get_peers,
        open_mesh,
        resume,
        tell,
    )
    from .surfaces.recording import RecordingError, read, record, replay
    from .teleoperation.teleoperator import Teleoperator

_MODULES = {
    "drivers": (
        "HardwareDriver",
        "list_driver_coverage",
        "list_native_drivers",
        "list_robots",
        "register_native_driver",
        "register_robot",
    ),
    "caller.handle.robot": ("AsyncRobot", "RealRobot", "Robot", "SimRobot", "open_robot"),
    "surfaces.agents.asking": ("ask_on_console",),
    "surfaces.agents.fleet": ("fleet",),
    "policies": ("MockPolicy", "Policy", "create_policy", "register_policy"),
    "surfaces.dataset": ("record_dataset", "replay_episode"),
    "surfaces.mesh": (
        "TLS",
        "Access",
        "MeshConfig",
        "broadcast",
        "control",
        "estop",
        "estop_button",
        "get_peers",
        "open_mesh",
        "resume",
        "tell",
    ),
    "teleoperation.teleoperator": ("Teleoperator",),
    "surfaces.recording": ("RecordingError", "read", "record", "replay"),
}

__all__ = [
    "TLS",
    "Access",
    "AsyncRobot",
    "HardwareDriver",
    "MeshConfig",
    "MockPolicy",
    "Policy",
    "RealRobot",
    "RecordingError",
    "Robot",
    "SimRobot",
    "Teleoperator",
    "__version__",
    "ask_on_console",
    "broadcast",
    "control",
    "create_policy",
    "estop",
    "estop_button",
    "fleet",
    "get_peers",
    "list_driver_coverage",
    "list_native_drivers",
    "list_robots",
    "open_mesh",
    "open_robot",
    "read",
    "record",
    "record_dataset",
    "register_native_driver",
    "register_policy",
    "register_robot",
    "replay",
    "replay_episode",
    "resume",
    "tell",
]


def __getattr__(name: str) -> Any:
    # Modules are loaded at the first use of a name, since the wire and root processes import this
    # package and do not need its user interfaces.
    for module, names in _MODULES.items():
        if name in names:
            try:
                return getattr(import_module(f"{__name__}.{module}"), name)
            except ImportError as failure:
                # hasattr(), help() and ``import *`` read every name. So reading a name never raises, and only a
                # call does.
                return import_module(f"{__name__}.contract.extras").refusing(name, failure)
    # An ImportError is raised, because ``from strands_actors import ...`` would not show the text of an
    # AttributeError.
    if name[:1] != "_" and (hint := import_module(f"{__name__}.caller.handle.reference_names").package_hint(name)):
        raise ImportError(hint, name=__name__)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return list(__all__)
