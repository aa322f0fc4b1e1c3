"""Entry of a twin's process when a robot is opened with ``transport="twin"`` or simulated."""

from __future__ import annotations

import socket
from typing import Any

from .supervisors.loading import load


def main(args: dict[str, Any], sock: socket.socket) -> None:
    serve = load(args["twin"])
    door = {} if args["door"] is None else {"door": args["door"]}
    serve(args["robot"], port_file=args["port_file"], log=args["log"], fault=None, parent_fd=sock.fileno(), **door)
