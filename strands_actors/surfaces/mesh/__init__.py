"""Robots that can be watched, commanded and stopped from other processes and hosts.

MeshConfig    how a robot can be reached: by default by its own user, on this host
open_mesh     the other end: subscribe, ask, stop
control       the lease of a robot elsewhere
estop         every robot on the mesh, from a program without trio
get_peers     who is there; tell: have one run a policy; broadcast: ask all, or stop all
estop_button  the same, joined in advance: the order leaves in the thread that presses
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .client import MeshClient, open_mesh
    from .config import TLS, Access, MeshConfig
    from .outcome import Outcome
    from .remote import RemoteRobot, control
    from .sync import broadcast, estop, estop_button, get_peers, resume, tell

_WHERE = {
    "TLS": "config",
    "Access": "config",
    "MeshClient": "client",
    "MeshConfig": "config",
    "Outcome": "outcome",
    "RemoteRobot": "remote",
    "broadcast": "sync",
    "control": "remote",
    "estop": "sync",
    "estop_button": "sync",
    "get_peers": "sync",
    "open_mesh": "client",
    "resume": "sync",
    "tell": "sync",
}

__all__ = [
    "TLS",
    "Access",
    "MeshClient",
    "MeshConfig",
    "Outcome",
    "RemoteRobot",
    "broadcast",
    "control",
    "estop",
    "estop_button",
    "get_peers",
    "open_mesh",
    "resume",
    "tell",
]


def __getattr__(name: str) -> Any:
    # Lazy: a robot's processes need the configuration and nothing else.
    if name in _WHERE:
        from importlib import import_module

        return getattr(import_module(f"{__name__}.{_WHERE[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
