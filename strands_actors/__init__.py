"""Robots as supervised trees of actors.

from strands_actors import Robot

arm = Robot("so101", mode="real", transport="twin")
arm.connect_eagerly()
arm.send_action({"shoulder_pan": 10.0})
arm.cleanup()
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from .version import __version__

if TYPE_CHECKING:
    from .caller.robot import AsyncRobot, RealRobot, Robot, SimRobot, open_robot
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
    "caller.robot": ("AsyncRobot", "RealRobot", "Robot", "SimRobot", "open_robot"),
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
    # Lazy: the wire and root processes import this package and need none of the surfaces.
    for module, names in _WHERE.items():
        if name in names:
            try:
                return getattr(import_module(f"{__name__}.{module}"), name)
            except ImportError as failure:
                # hasattr(), help() and ``import *`` ask for every name: only a call refuses.
                return import_module(f"{__name__}.contract.extras").refusing(name, failure)
    # An ImportError: ``from strands_actors import ...`` hides the text of an AttributeError.
    if name[:1] != "_" and (hint := import_module(f"{__name__}.caller.reference_names").package_hint(name)):
        raise ImportError(hint, name=__name__)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return list(__all__)
