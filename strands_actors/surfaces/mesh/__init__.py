"""Watch, command and stop robots from other processes and hosts.

MeshConfig    how other programs reach a robot; by default only programs of its user on this host do
open_mesh     join the mesh as a client: subscribe, send commands, stop (on trio)
control       hold the lease (the right to command) of a robot (on trio)

For programs without trio:

estop         stop every robot on the mesh
estop_button  like estop, but connected in advance, so that a press sends the stop at once
get_peers     list the robots
tell          have one robot run a policy
broadcast     ask all robots for a reading, or stop them all
resume        lift the lockout of one robot and energise it
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
    # The modules are imported on first use, since a robot's processes need only the configuration.
    if name in _WHERE:
        from importlib import import_module

        return getattr(import_module(f"{__name__}.{_WHERE[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
