"""The orders to a host, and its answers, as lines of JSON on its socket."""

from __future__ import annotations

import enum
from pathlib import Path

import msgspec

from strands_actors.caller.processes.run_directory import run_dir

from .keeper import RobotStatus

LINE_BYTES = 1024 * 1024
"""Longest line."""


class Verb(enum.StrEnum):
    STATUS = "status"
    RELOAD = "reload"
    DOWN = "down"


class Order(msgspec.Struct, frozen=True):
    """An order to the host."""

    order: Verb


class FaultOf(msgspec.Struct, frozen=True):
    """A fault of the host's file. ``line`` is 0 if the whole file has the fault."""

    line: int
    text: str


class ServiceStatus(msgspec.Struct, frozen=True):
    """A service of the host.

    Attributes:
        address: Where it is; empty if it does not run. That of the console has its token.
        problem: Why it does not run; empty if it does.
    """

    address: str
    problem: str


class HostStatus(msgspec.Struct, frozen=True):
    """The answer to an order.

    Attributes:
        pid: Process id of the host.
        file: Its file.
        robots: Its robots, by name.
        services: Its services, by name: metrics, ros2, web.
        problem: Why the adapters cannot be remembered; empty if they can.
        changed: After a reload: the robots that were stopped or started.
        faults: After a reload: the faults of the file. Nothing was changed if there are any.
    """

    pid: int
    file: str
    robots: list[RobotStatus]
    services: dict[str, ServiceStatus] = {}
    problem: str = ""
    changed: list[str] = []
    faults: list[FaultOf] = []


def socket_path() -> Path:
    """Return the path of the host's socket. Only this user can reach it."""
    return run_dir() / ".host.sock"


def lock_path() -> Path:
    """Return the path of the file that a running host has locked. Its content is the host's process id."""
    return run_dir() / ".host.held"
