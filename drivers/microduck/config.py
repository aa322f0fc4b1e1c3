"""Settings of a Microduck, shared by the process that drives it (the wire) and the supervising process (root),
which can also stop it."""

from __future__ import annotations

import re
from collections.abc import Mapping

import msgspec

from strands_actors.contract.wire import WireDown
from strands_actors.drivers.common.ports.addresses import is_host

from .protocol import ROBOT_SOCKET

USER = "radxa"
"""Default user of the duck's board."""

ACCEPTED = "/path/to/robotd.sock or ssh://[user@]host[:port]"

_SSH = re.compile(
    r"(?:(?P<user>[A-Za-z_][\w.-]*)@)?(?P<host>[A-Za-z0-9][\w.-]*|\[[0-9A-Fa-f:.]+\])(?::(?P<port>\d{1,5}))?"
)


LATE_S = 0.5
"""Longest delay after which a request of a killed client may still be carried out [assumed]. robotd serves each
connection one request at a time, and the root has its own connection."""


class Endpoint(msgspec.Struct, frozen=True):
    """The address of the daemon robotd: a path on this machine, or one on ``host``, which is reached with ssh."""

    path: str
    host: str = ""  # ``user@host`` for ssh; empty for this machine
    ssh_port: int = 0  # 0 for the default port of ssh

    @property
    def name(self) -> str:
        return f"ssh://{self.host}" if self.host else self.path


def parse_port(port: str, user: str = USER) -> Endpoint:
    """Parse the option ``port``. Raise ``ValueError``, which lists the accepted forms. A host that begins with
    a dash is refused, because ssh would take it for an option."""
    scheme, separator, rest = port.partition("://")
    if not separator:
        scheme, rest = "unix", port
    if scheme == "unix" and rest.startswith("/") and rest.isprintable():
        return Endpoint(rest)
    if scheme == "ssh" and (match := _SSH.fullmatch(rest.removesuffix("/"))):
        number = int(match["port"] or 0)
        host = match["host"].strip("[]")
        if number < 65536 and is_host(host):
            return Endpoint(ROBOT_SOCKET, f"{match['user'] or user}@{host}", number)
    raise ValueError(f"port is {port!r}. Give {ACCEPTED}")


def endpoint_of_environment(environment: Mapping[str, str]) -> str:
    """Return the option ``port`` from the environment variable ``MICRODUCK_SOCKET``, or else ``MICRODUCK_HOST``.
    Without both return the port for a program that runs on the duck itself."""
    if path := environment.get("MICRODUCK_SOCKET"):
        return path
    if host := environment.get("MICRODUCK_HOST"):
        return host if "://" in host else f"ssh://{host}"
    return ROBOT_SOCKET


class MicroduckConfig(msgspec.Struct, frozen=True):
    robot: str
    port: str
    user: str
    axes: tuple[str, ...]
    ids: tuple[int, ...]
    modes: tuple[str, ...]  # known drive modes, in the order of their codes
    skills: tuple[str, ...]  # skills of the standard robot, used if the robot reports no skills
    api_version: int
    timeout_s: float
    subscribe_hz: int | None
    silent_s: float = 0.6
    """The link counts as lost after so long without a state."""

    def endpoint(self) -> Endpoint:
        """Parse the configured port. Raise ``WireDown`` if it is invalid."""
        try:
            return parse_port(self.port, self.user)
        except ValueError as error:
            raise WireDown(f"{self.robot}: {error}") from None
