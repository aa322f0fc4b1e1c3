"""Robots as supervised trees of actors.

from strands_actors import Robot

arm = Robot("so101", mode="real", transport="twin")
arm.connect_eagerly()
arm.send_action({"shoulder_pan": 10.0})
arm.cleanup()
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .mesh import MeshConfig, estop, open_mesh
    from .robot import Robot, open_robot

__all__ = ["MeshConfig", "Robot", "estop", "open_mesh", "open_robot"]
__version__ = "0.1.0"


def __getattr__(name: str) -> Any:
    # Lazy: the wire and root processes import this package and need none of the surfaces.
    if name in ("Robot", "open_robot"):
        from . import robot

        return getattr(robot, name)
    if name in __all__:
        from . import mesh

        return getattr(mesh, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
