"""Robots that can be watched, commanded and stopped from other processes and hosts.

MeshConfig    how a robot can be reached: by default by its own user, on this host
open_mesh     the other end: subscribe, ask, stop
control       the lease of a robot elsewhere
estop         every robot on the mesh, from a program without trio
estop_button  the same, joined in advance: the order leaves in the thread that presses
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .client import MeshClient, open_mesh
    from .config import TLS, Access, MeshConfig
    from .outcome import Outcome
    from .remote import RemoteRobot, control
    from .sync import estop, estop_button, resume

_WHERE = {
    "TLS": "config",
    "Access": "config",
    "MeshClient": "client",
    "MeshConfig": "config",
    "Outcome": "outcome",
    "RemoteRobot": "remote",
    "control": "remote",
    "estop": "sync",
    "estop_button": "sync",
    "open_mesh": "client",
    "resume": "sync",
}

__all__ = [
    "TLS",
    "Access",
    "MeshClient",
    "MeshConfig",
    "Outcome",
    "RemoteRobot",
    "control",
    "estop",
    "estop_button",
    "open_mesh",
    "resume",
]


def __getattr__(name: str) -> Any:
    # Lazy: a robot's processes need the configuration and nothing else.
    if name in _WHERE:
        from importlib import import_module

        return getattr(import_module(f"{__name__}.{_WHERE[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
