"""Control robots, each as a supervised tree of actors.

    from strands_actors import Robot

    arm = Robot("so101", mode="real", transport="twin")  # a twin; with port= a real arm
    arm.connect_eagerly()
    arm.send_action({"shoulder_pan": 10.0})
    arm.cleanup()

``Robot``             make the handle of one robot, real or simulated (``RealRobot``, ``SimRobot``)
``open_robot``        the same for a trio program (``AsyncRobot``)
``Policy``            base class of a policy; ``create_policy`` and ``register_policy`` go by name
``Teleoperator``      a leader that controls a robot
``record``, ``read``, ``replay``  record a robot, read a recording, decide it again
``record_dataset``, ``replay_episode``  episodes in LeRobot's format
``get_peers``, ``tell``, ``broadcast``, ``estop``, ``resume``  robots on the mesh
``list_robots``, ``list_driver_coverage``  names of robots, and the drivers that exist for each

A name is loaded at its first use. If it needs a package that is missing, a call names that package.
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

_WHERE = {
    "drivers": (
        "HardwareDriver",
        "list_driver_coverage",
        "list_native_drivers",
        "list_robots",
        "register_native_driver",
        "register_robot",
    ),
    "caller.handle.robot": ("AsyncRobot", "RealRobot", "Robot", "SimRobot", "open_robot"),
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
    "broadcast",
    "control",
    "create_policy",
    "estop",
    "estop_button",
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
    for module, names in _WHERE.items():
        if name in names:
            try:
                return getattr(import_module(f"{__name__}.{module}"), name)
            except ImportError as failure:
                # hasattr(), help() and ``import *`` read every name, so only a call raises.
                return import_module(f"{__name__}.contract.extras").refusing(name, failure)
    # This is an ImportError, since ``from strands_actors import ...`` hides an AttributeError's text.
    if name[:1] != "_" and (hint := import_module(f"{__name__}.caller.handle.reference_names").package_hint(name)):
        raise ImportError(hint, name=__name__)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return list(__all__)
