"""Configure how other programs reach a robot. By default a robot listens only on a unix socket of its user.

    MeshConfig(
        listen="tls/0.0.0.0:7447",
        tls=TLS("keys/ca.pem", "keys/so101.pem", "keys/so101.key"),
        access=Access(viewers=["viewer"], operators=["operator"]),
    )

The same settings may stand in a TOML file that ``STRANDS_ACTORS_MESH`` or ``--mesh`` names. A connection to
another host needs TLS, with a certificate on both ends. The name in a robot's certificate is the robot's
name. The name in another certificate decides if its holder may watch or command.
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


class _Hints(NamedTuple):
    """How a message refers to a setting: in the syntax of Python or of TOML."""

    tls: str
    set_insecure: str


_IN_PYTHON = _Hints("mesh=MeshConfig(..., tls=TLS(ca, certificate, key))", "insecure=True there")
_IN_TOML = _Hints("a table [tls] with ca, certificate and key", "insecure = true")


class MeshConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """How other programs reach a robot, or how a program reaches robots.

    Attributes:
        listen: Zenoh endpoints to listen on, one or several.
        connect: Zenoh endpoints to connect to, one or several.
        tls: The files of this program's certificate and key.
        access: Which certificates may watch the robot, and which may command it.
        insecure: Allow endpoints without TLS. Then every program that can connect to the port can command the
            robot. With 127.0.0.1 these are the programs of all users of this host.
    """

    listen: Names = ()
    connect: Names = ()
    tls: TLS | None = None
    access: Access = Access()
    insecure: bool = False

    @classmethod
    def of(cls, mesh: MeshConfig | str | os.PathLike[str] | None) -> MeshConfig:
        """Return the checked configuration for a ``mesh=`` argument.

        Args:
            mesh: A configuration, the path of its file, or None for the file that ``STRANDS_ACTORS_MESH``
                names.

        Raises:
            ValueError: The configuration cannot be used.
        """
        if mesh is None:
            config = cls.from_environment()
        elif isinstance(mesh, cls):
            config = mesh
        elif isinstance(mesh, str | os.PathLike):
            config = cls.load(mesh)
        else:
            raise ValueError(f"mesh is {shown(mesh)}. Give MeshConfig(...), or the path of a TOML file")
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
            raise ValueError(f"mesh: the file is {shown(path)}. Give the path of a TOML file, as text") from None
        try:
            config = msgspec.toml.decode(file.read_bytes(), type=cls)
        except OSError as error:
            raise ValueError(f"mesh: {path} cannot be read: {error.strerror}") from error
        except (msgspec.MsgspecError, UnicodeDecodeError) as error:
            raise ValueError(f"mesh: {path}: {error}{_valid_keys(error)}") from error
        config._check_endpoints(_IN_TOML)  # Check here, so that a message refers to settings in TOML syntax.
        if config.tls is not None:
            ours = {name: str(file.parent / value) for name, value in msgspec.structs.asdict(config.tls).items()}
            config = msgspec.structs.replace(config, tls=TLS(**ours))
        return config

    @classmethod
    def from_environment(cls) -> MeshConfig:
        """Read the file that ``STRANDS_ACTORS_MESH`` names. If the variable is not set, return the default:
        only sockets of this user."""
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
            ValueError: The configuration cannot be used. The message names an accepted value.
        """
        self._check_types()
        self._check_endpoints(_IN_PYTHON)
        if self.tls is None:
            return
        for file_name, path in msgspec.structs.asdict(self.tls).items():
            if not os.access(path, os.R_OK):
                raise ValueError(
                    f"mesh: the {file_name} {path} cannot be read. "
                    "Make certificates with `strands-actors mesh keys DIR`"
                )

        _check_key(self.tls.key)
        try:
            common_name(self.tls.certificate)
        except ValueError as error:
            raise ValueError(f"mesh: {error}") from error
        _check_access(_list(self.access.viewers), _list(self.access.operators))

    def _check_types(self) -> None:
        """Check the types of a configuration that was made in Python. Otherwise the text ``insecure="false"``
        would count as true."""
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
                raise ValueError(f"mesh: {name} is {shown(value)}. Give {accepted}")

    def _check_endpoints(self, hints: _Hints) -> None:
        for endpoint in (*self.listens, *self.connects):
            self._check_endpoint(endpoint, hints)

    def _check_endpoint(self, endpoint: str, hints: _Hints) -> None:
        protocol, _, address = endpoint.partition("/")
        fits = _has_port(address) if protocol in ("tcp", "tls") else protocol == SOCKET and address
        if not fits:
            raise ValueError(f"mesh: {endpoint!r} is not an endpoint. Give an endpoint such as tls/0.0.0.0:7447")
        if protocol == "tls" and self.tls is None:
            raise ValueError(f"mesh: {endpoint} needs certificates. Give {hints.tls}")
        if protocol == "tcp" and self.tls is not None:
            raise ValueError(f"mesh: {endpoint} would accept commands without TLS. Use tls/ for all endpoints")
        if protocol == "tcp" and not self.insecure:
            risk = (
                "has no TLS, so every user of this host"
                if _is_loopback(address)
                else "has no TLS, so everyone in its network"
            )
            raise ValueError(
                f"mesh: {endpoint} {risk} could move the robot. "
                f"Use tls/ and {hints.tls}, or set {hints.set_insecure}"
            )

    @property
    def identity(self) -> str:
        """Return the name in this program's certificate, or an empty text if there is no certificate."""
        return "" if self.tls is None else common_name(self.tls.certificate)

    @property
    def own_prefix(self) -> str:
        """Return the prefix that the names of this program's senders and nodes must have. Robots answer no
        other names."""
        return own_prefix(self.identity) if self.tls is not None else ""

    def check_robot(self, robot: str) -> None:
        """Check that the certificate has this robot's name. Otherwise peers would reject the robot's answers.

        Raises:
            ValueError: The certificate has another name.
        """
        if self.tls is not None and self.identity != robot:
            raise ValueError(
                f"mesh: {self.tls.certificate} is the certificate of {self.identity!r}, "
                f"but this robot is {robot!r}. "
                f"Make a certificate with `strands-actors mesh keys DIR --robot {robot}`"
            )

    def settings_for(self, robot: str) -> dict[str, Any]:
        """Return zenoh's settings for a program that communicates with this robot only."""
        return {} if self.tls is None else {**self.settings(), "access_control": only(robot)}

    def settings(self) -> dict[str, Any]:
        """Return zenoh's settings for these certificates, by the path of each setting."""
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
        """Return zenoh's settings for a robot, with its access rules."""
        if self.tls is None:
            return {"access_control": access_control(anybody=self.insecure)}
        rules = access_control(_list(self.access.viewers), _list(self.access.operators))
        return {**self.settings(), "access_control": rules}


def _valid_keys(error: Exception) -> str:
    """Return a text with the valid keys, if the error is about an unknown key. Otherwise return an empty
    text."""
    text = str(error)
    if "unknown field" not in text:
        return ""
    config_class = TLS if "$.tls" in text else Access if "$.access" in text else MeshConfig
    return f". There are {', '.join(config_class.__struct_fields__)}"


def _check_key(path: str) -> None:
    """Raise ``ValueError`` if other users can read the private key. A key that the user root owns may be
    readable by its group, since this user may be a member."""
    status = os.stat(path)
    others = 0o037 if status.st_uid == 0 and os.getuid() != 0 else 0o077
    if status.st_mode & others:
        raise ValueError(
            f"mesh: other users can read the private key {path} (mode {status.st_mode & 0o777:03o}). "
            f"Run chmod 600 {path}"
        )


def _check_access(viewers: list[str], operators: list[str]) -> None:
    for name in (*viewers, *operators):
        if not is_name(name):
            raise ValueError(
                f"mesh: access: the name {name!r} is not valid. Use at most 64 letters, digits, _ . and -"
            )
    for name in operators:
        if len(name) > MAX_OPERATOR:
            raise ValueError(f"mesh: access: the name {name!r} is too long. Use at most {MAX_OPERATOR} characters")
        for operator in operators:
            if operator.startswith(own_prefix(name)):
                raise ValueError(
                    f"mesh: access: {name} could receive answers to {operator}. Give {name} another name"
                )


def _are_names(value: object) -> bool:
    """Return True for a text, or a collection of texts."""
    several = isinstance(value, Sequence | AbstractSet) and all(isinstance(each, str) for each in value)
    return isinstance(value, str) or several


def _list(names: str | Sequence[str]) -> list[str]:
    return [names] if isinstance(names, str) else list(names)


def _has_port(address: str) -> bool:
    """Return True if an address is ``host:port``. Zenoh's link settings (``?...`` or ``#...``) may follow."""
    host, _, port = re.split("[?#]", address, maxsplit=1)[0].rpartition(":")
    return bool(host) and port.isascii() and port.isdigit() and int(port) <= 65535


def _is_loopback(address: str) -> bool:
    host = address.rpartition(":")[0].strip("[]")
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"
