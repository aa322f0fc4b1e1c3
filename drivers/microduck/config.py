"""What the wire and the stop channel of a Microduck know of it."""

from __future__ import annotations

import re
from collections.abc import Mapping

import msgspec

from strands_actors.contract.wire import WireDown
from strands_actors.drivers.common.addresses import is_host

from .protocol import ROBOT_SOCKET

USER = "radxa"
"""Of the duck's board, where nobody says another."""

ACCEPTED = "/path/to/robotd.sock or ssh://[user@]host[:port]"

_SSH = re.compile(
    r"(?:(?P<user>[A-Za-z_][\w.-]*)@)?(?P<host>[A-Za-z0-9][\w.-]*|\[[0-9A-Fa-f:.]+\])(?::(?P<port>\d{1,5}))?"
)


LATE_S = 0.5
"""A request of a client that was killed may be carried out so late [assumed]. robotd serves each
connection one request at a time, and the root has a connection of its own."""


class Endpoint(msgspec.Struct, frozen=True):
    """Where robotd listens: a path here, or one on ``host``, which ssh reaches."""

    path: str
    host: str = ""  # user@host
    ssh_port: int = 0  # 0: what ssh takes by itself

    @property
    def name(self) -> str:
        return f"ssh://{self.host}" if self.host else self.path


def parse_port(port: str, user: str = USER) -> Endpoint:
    """Raise ``ValueError`` with what would be accepted. A host never begins with a dash: to ssh
    that would be an option."""
    scheme, found, rest = port.partition("://")
    if not found:
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
    """Return the port that ``MICRODUCK_SOCKET`` or ``MICRODUCK_HOST`` names, else the one of a
    program on the duck itself."""
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
    modes: tuple[str, ...]  # drive modes that are known, in the order of their codes
    skills: tuple[str, ...]  # of a stock robot, where it tells none
    api_version: int
    timeout_s: float
    subscribe_hz: int | None
    silent_s: float = 0.6
    """Without a state for so long the link counts as lost."""

    def endpoint(self) -> Endpoint:
        """Raise ``WireDown`` for a port that is none."""
        try:
            return parse_port(self.port, self.user)
        except ValueError as error:
            raise WireDown(f"{self.robot}: {error}") from None
