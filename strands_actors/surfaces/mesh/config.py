"""Configure how a robot can be reached. By default this is a unix socket of its user, and nothing else.

    MeshConfig(
        listen="tls/0.0.0.0:7447",
        tls=TLS("keys/ca.pem", "keys/so101.pem", "keys/so101.key"),
        access=Access(viewers=["viewer"], operators=["operator"]),
    )

or the same as TOML, in a file that ``STRANDS_ACTORS_MESH`` or ``--mesh`` names. A connection to another
host needs TLS with certificates on both ends. The name in a certificate identifies a robot, or decides
the rights of its holder.
"""

from __future__ import annotations

import ipaddress
import os
import re
from collections.abc import Sequence
from collections.abc import Set as AbstractSet
from pathlib import Path
from typing import Any, NamedTuple

import msgspec

from strands_actors.contract.shown import shown
from strands_actors.supervisors.mesh.schemas import is_name

from .access import access_control, only, own_prefix
from .certificate import common_name

ENVIRONMENT = "STRANDS_ACTORS_MESH"
SOCKET = "unixsock-stream"
"""The protocol of this user's sockets on this host."""

MAX_OPERATOR = 40
"""Most characters of an operator's name, since the names of its senders begin with it."""

Names = str | Sequence[str]


class TLS(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Paths of PEM files: the trusted authority, this program's certificate, and its private key."""

    ca: str
    certificate: str
    key: str


class Access(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Common names of certificates. Viewers read telemetry. Operators also command, stop and resume."""

    viewers: Names = ("viewer",)
    operators: Names = ("operator",)


class _Words(NamedTuple):
    """Words of the messages about a missing setting, for Python or TOML."""

    tls: str
    insecure: str


_IN_PYTHON = _Words("mesh=MeshConfig(..., tls=TLS(ca, certificate, key))", "insecure=True there")
_IN_TOML = _Words("a table [tls] with ca, certificate and key", "insecure = true")


class MeshConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """How a robot can be reached, or how to reach robots.

    Attributes:
        listen: Zenoh endpoints to listen on, one or several.
        connect: Zenoh endpoints to connect to, one or several.
        tls: The certificates.
        access: The rights of certificates.
        insecure: Allow endpoints without TLS. Every program that reaches the port can then command the
            robot; on 127.0.0.1, every user of this host.
    """

    listen: Names = ()
    connect: Names = ()
    tls: TLS | None = None
    access: Access = Access()
    insecure: bool = False

    @classmethod
    def of(cls, given: MeshConfig | str | os.PathLike[str] | None) -> MeshConfig:
        """Return the checked configuration for a ``mesh=`` argument.

        Args:
            given: A configuration, the path of its file, or None for the environment's.

        Raises:
            ValueError: It cannot be used.
        """
        if given is None:
            config = cls.from_environment()
        elif isinstance(given, cls):
            config = given
        elif isinstance(given, str | os.PathLike):
            config = cls.load(given)
        else:
            raise ValueError(f"mesh: it is {shown(given)}. give MeshConfig(...), or the path of its TOML file")
        config.check()
        return config

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> MeshConfig:
        """Read a TOML file. Paths in it are relative to the file.

        Raises:
            ValueError: The file cannot be read, or it has an unknown key or a bad endpoint.
        """
        try:
            file = Path(path)
        except TypeError:
            raise ValueError(f"mesh: the file is {shown(path)}. give its path, as text") from None
        try:
            config = msgspec.toml.decode(file.read_bytes(), type=cls)
        except OSError as error:
            raise ValueError(f"mesh: {path} cannot be read: {error.strerror}") from error
        except (msgspec.MsgspecError, UnicodeDecodeError) as error:
            raise ValueError(f"mesh: {path}: {error}{_keys_there(error)}") from error
        config._check_endpoints(_IN_TOML)  # Checked here, so that the message uses the words of TOML.
        if config.tls is not None:
            ours = {name: str(file.parent / value) for name, value in msgspec.structs.asdict(config.tls).items()}
            config = msgspec.structs.replace(config, tls=TLS(**ours))
        return config

    @classmethod
    def from_environment(cls) -> MeshConfig:
        """Read the file that ``STRANDS_ACTORS_MESH`` names. Without it, only this user's own sockets are
        used."""
        path = os.environ.get(ENVIRONMENT)
        return cls.load(path) if path else cls()

    @property
    def listens(self) -> list[str]:
        return _list(self.listen)

    @property
    def connects(self) -> list[str]:
        return _list(self.connect)

    def check(self) -> None:
        """Check the whole configuration.

        Raises:
            ValueError: It cannot be used. The text names a value that would be accepted.
        """
        self._check_types()
        self._check_endpoints(_IN_PYTHON)
        if self.tls is None:
            return
        for what, path in msgspec.structs.asdict(self.tls).items():
            if not os.access(path, os.R_OK):
                raise ValueError(
                    f"mesh: the {what} {path} cannot be read. `strands-actors mesh keys DIR` makes a set of them"
                )

        _check_key(self.tls.key)
        try:
            common_name(self.tls.certificate)
        except ValueError as error:
            raise ValueError(f"mesh: {error}") from error
        _check_access(_list(self.access.viewers), _list(self.access.operators))

    def _check_types(self) -> None:
        """Check the types of a configuration made in Python, where ``insecure="false"`` would count as
        true."""
        endpoints = "an endpoint like 'tls/0.0.0.0:7447', or a list of them"
        rows: list[tuple[str, object, bool, str]] = [
            ("listen", self.listen, _are_names(self.listen), endpoints),
            ("connect", self.connect, _are_names(self.connect), endpoints),
            ("insecure", self.insecure, isinstance(self.insecure, bool), "True or False"),
            ("tls", self.tls, isinstance(self.tls, TLS | None), "TLS(ca, certificate, key)"),
            ("access", self.access, isinstance(self.access, Access), "Access(viewers, operators)"),
        ]
        if isinstance(self.tls, TLS):
            files = msgspec.structs.asdict(self.tls).items()
            rows += [(f"tls.{name}", path, isinstance(path, str | os.PathLike), "a path") for name, path in files]
        if isinstance(self.access, Access):
            roles = msgspec.structs.asdict(self.access).items()
            rows += [
                (f"access.{role}", names, _are_names(names), "a name, or a list of them") for role, names in roles
            ]
        for name, value, fits, accepted in rows:
            if not fits:
                raise ValueError(f"mesh: {name} is {shown(value)}. give {accepted}")

    def _check_endpoints(self, words: _Words) -> None:
        for endpoint in (*self.listens, *self.connects):
            self._check_endpoint(endpoint, words)

    def _check_endpoint(self, endpoint: str, words: _Words) -> None:
        protocol, _, address = endpoint.partition("/")
        fits = _has_port(address) if protocol in ("tcp", "tls") else protocol == SOCKET and address
        if not fits:
            raise ValueError(f"mesh: {endpoint!r} is no endpoint. give one like tls/0.0.0.0:7447")
        if protocol == "tls" and self.tls is None:
            raise ValueError(f"mesh: {endpoint} needs certificates: {words.tls}")
        if protocol == "tcp" and self.tls is not None:
            raise ValueError(f"mesh: {endpoint} beside TLS would be a way around it. use tls/ for all endpoints")
        if protocol == "tcp" and not self.insecure:
            risk = (
                "is open to every user of this host, who"
                if _is_loopback(address)
                else "leaves this host, and anybody there"
            )
            raise ValueError(
                f"mesh: {endpoint} {risk} could move the robot. use tls/ and {words.tls}, or say {words.insecure}"
            )

    @property
    def identity(self) -> str:
        """Return the name in this program's certificate; empty without one."""
        return "" if self.tls is None else common_name(self.tls.certificate)

    @property
    def own_prefix(self) -> str:
        """Return the prefix of the names of this program's senders and nodes. Robots answer only names
        with it."""
        return own_prefix(self.identity) if self.tls is not None else ""

    def check_robot(self, robot: str) -> None:
        """Check that the certificate is of this robot. Otherwise peers would reject its answers.

        Raises:
            ValueError: It is of another name.
        """
        if self.tls is not None and self.identity != robot:
            raise ValueError(
                f"mesh: {self.tls.certificate} is the certificate of {self.identity!r}, this robot is {robot!r}: "
                f"nobody would believe its answers. `strands-actors mesh keys DIR --robot {robot}` makes one"
            )

    def settings_for(self, robot: str) -> dict[str, Any]:
        """As ``settings``, for a caller that communicates with this robot only."""
        return {} if self.tls is None else {**self.settings(), "access_control": only(robot)}

    def settings(self) -> dict[str, Any]:
        """Return settings of zenoh, by their paths."""
        if self.tls is None:
            return {}
        ca, certificate, key = (os.path.abspath(path) for path in msgspec.structs.astuple(self.tls))
        return {
            "transport/link/tls/root_ca_certificate": ca,
            "transport/link/tls/listen_certificate": certificate,
            "transport/link/tls/listen_private_key": key,
            "transport/link/tls/connect_certificate": certificate,
            "transport/link/tls/connect_private_key": key,
            "transport/link/tls/enable_mtls": True,
            "transport/link/tls/close_link_on_expiration": True,
        }

    def robot_settings(self) -> dict[str, Any]:
        """As ``settings``, with the access rules of a robot."""
        if self.tls is None:
            return {"access_control": access_control(anybody=self.insecure)}
        rules = access_control(_list(self.access.viewers), _list(self.access.operators))
        return {**self.settings(), "access_control": rules}


def _keys_there(error: Exception) -> str:
    """Return the list of valid keys for the message about an unknown key; empty for other errors."""
    text = str(error)
    if "unknown field" not in text:
        return ""
    kind = TLS if "$.tls" in text else Access if "$.access" in text else MeshConfig
    return f". there are {', '.join(kind.__struct_fields__)}"


def _check_key(path: str) -> None:
    """Raise ``ValueError`` if other users than its owner can read the private key. A key that root owns
    may also be readable by its group, since this user may be in it."""
    status = os.stat(path)
    others = 0o037 if status.st_uid == 0 and os.getuid() != 0 else 0o077
    if status.st_mode & others:
        raise ValueError(
            f"mesh: the key {path} can be read by others (mode {status.st_mode & 0o777:03o}), who then are you. "
            f"chmod 600 {path}"
        )


def _check_access(viewers: list[str], operators: list[str]) -> None:
    for name in (*viewers, *operators):
        if not is_name(name):
            raise ValueError(f"mesh: access: {name!r} is no name: give letters, digits, _ . and -, 64 at most")
    for name in operators:
        if len(name) > MAX_OPERATOR:
            raise ValueError(f"mesh: access: {name!r} is longer than {MAX_OPERATOR} characters")
        for other in operators:
            if other.startswith(own_prefix(name)):
                raise ValueError(f"mesh: access: {name} could hear what {other} is answered: give it another name")


def _are_names(given: object) -> bool:
    """Return True for a text, or a collection of texts."""
    several = isinstance(given, Sequence | AbstractSet) and all(isinstance(each, str) for each in given)
    return isinstance(given, str) or several


def _list(names: str | Sequence[str]) -> list[str]:
    return [names] if isinstance(names, str) else list(names)


def _has_port(address: str) -> bool:
    """Return True for ``host:port``, which zenoh's settings of a link may follow."""
    host, _, port = re.split("[?#]", address, maxsplit=1)[0].rpartition(":")
    return bool(host) and port.isascii() and port.isdigit() and int(port) <= 65535


def _is_loopback(address: str) -> bool:
    host = address.rpartition(":")[0].strip("[]")
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"
