"""The code that runs in the process of a simulated robot, for ``transport="twin"`` and for simulations."""

from __future__ import annotations

import socket
from typing import Any

from strands_actors.contract.loading import load


def main(args: dict[str, Any], sock: socket.socket) -> None:
    if args["backend"]:
        load("strands_actors.drivers.common.physics.solver:choose")(args["backend"])
    serve = load(args["twin"])
    names = ("control", "place", "options", "pictures", "on_wire")
    keywords = {name: args[name] for name in names if args[name] not in (None, False)}
    serve(
        args["robot"], port_file=args["port_file"], log=args["log"], fault=None, parent_fd=sock.fileno(), **keywords
    )
