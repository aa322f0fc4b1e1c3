"""Make a certificate authority and certificates, for a private mesh or for tests. Needs the extra
``[mesh]``.

``ca.key`` signs the certificates of all peers that are admitted, so keep it off the robots. Each robot has
a certificate with its name. A certificate for a viewer or an operator is not valid for a server, so its
holder cannot pose as a robot.
"""

from __future__ import annotations

import datetime
import ipaddress
import os
import socket
from collections.abc import Sequence
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from strands_actors.supervisors.mesh.schemas import is_name

NAMES = ("operator", "viewer")
DAYS = 365
LOCAL = ("localhost", "127.0.0.1")

_Key = ec.EllipticCurvePrivateKey


def make(
    directory: Path,
    names: Sequence[str] = NAMES,
    hosts: Sequence[str] = (),
    days: int = DAYS,
    robots: Sequence[str] = (),
) -> list[Path]:
    """Write a certificate and a private key for each name, signed by the authority in ``directory``.

    If ``directory`` has no authority, make one.

    Args:
        directory: The folder for the files.
        names: Names of viewers and operators.
        hosts: Names and addresses of the robots' hosts. This host's names are added.
        days: Validity in days.
        robots: Names of robots on the mesh.

    Returns:
        The paths of the new files.

    Raises:
        FileExistsError: A file exists already, or the authority in ``directory`` cannot be used.
        ValueError: A name is not valid.
    """
    for name in (*names, *robots):
        if not is_name(name) or name == "ca":
            raise ValueError(f"the name {name!r} is not valid. Use at most 64 letters, digits, _ . and -")
    if both := sorted({*names} & {*robots}):
        raise ValueError(f"{both[0]} is the name of a robot and of an operator or viewer. Use different names")
    leaves = [directory / f"{name}.{ending}" for name in (*names, *robots) for ending in ("pem", "key")]
    existing = [str(file) for file in leaves if file.exists()]
    if existing:
        raise FileExistsError(f"{existing[0]} exists already. Use another directory, or other names")
    directory.mkdir(mode=0o700, parents=True, exist_ok=True)
    end = datetime.datetime.now(datetime.UTC) + datetime.timedelta(days=days)
    authority = [directory / "ca.pem", directory / "ca.key"]
    if any(file.exists() for file in authority):
        ca, ca_key = _read_authority(*authority)
        made = leaves
    else:
        ca_key = ec.generate_private_key(ec.SECP256R1())
        ca = _authority(ca_key, end)
        _write(directory, "ca", ca, ca_key)
        made = [*authority, *leaves]
    alternatives = [_alternative(host) for host in dict.fromkeys((*LOCAL, socket.gethostname(), *hosts))]
    for name in names:
        key = ec.generate_private_key(ec.SECP256R1())
        _write(directory, name, _leaf(name, key, ca, ca_key, (), end), key)
    for name in robots:
        key = ec.generate_private_key(ec.SECP256R1())
        _write(directory, name, _leaf(name, key, ca, ca_key, alternatives, end), key)
    return made


def make_own(directory: Path, host: str, days: int) -> x509.Certificate:
    """Write a certificate for a server at one address, which is signed by itself, and its key. Return it.

    Earlier files for this address are replaced.

    Args:
        directory: The folder for the files.
        host: Name or address of the server.
        days: Validity in days.
    """
    directory.mkdir(mode=0o700, parents=True, exist_ok=True)
    (directory / f"{host}.key").unlink(missing_ok=True)
    key = ec.generate_private_key(ec.SECP256R1())
    end = datetime.datetime.now(datetime.UTC) + datetime.timedelta(days=days)
    certificate = (
        _builder(_name(host), _name(host), key, end)
        .add_extension(x509.SubjectAlternativeName([_alternative(host)]), critical=False)
        .sign(key, hashes.SHA256())
    )
    _write(directory, host, certificate, key)
    return certificate


def _read_authority(certificate: Path, key: Path) -> tuple[x509.Certificate, _Key]:
    try:
        private_key = serialization.load_pem_private_key(key.read_bytes(), None)
        ca = x509.load_pem_x509_certificate(certificate.read_bytes())
    except (OSError, ValueError, TypeError) as error:
        raise FileExistsError(f"{certificate.parent} has an authority that cannot be used: {error}") from error
    if not isinstance(private_key, ec.EllipticCurvePrivateKey):
        raise FileExistsError(f"{key} was not made by this command. Use another directory")
    return ca, private_key


def _authority(key: _Key, end: datetime.datetime) -> x509.Certificate:
    name = _name("strands-actors mesh")
    return (
        _builder(name, name, key, end)
        .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
        .add_extension(_usage(signs=True), critical=True)
        .sign(key, hashes.SHA256())
    )


def _leaf(
    name: str,
    key: _Key,
    ca: x509.Certificate,
    ca_key: _Key,
    alternatives: Sequence[x509.GeneralName],
    end: datetime.datetime,
) -> x509.Certificate:
    """Return a certificate. ``alternatives`` are the addresses at which its holder is a server. Without
    addresses, the certificate is valid for a client only."""
    uses = [ExtendedKeyUsageOID.CLIENT_AUTH]
    if alternatives:  # A robot is a server, but may also connect to other robots as a client.
        uses.insert(0, ExtendedKeyUsageOID.SERVER_AUTH)
    builder = (
        _builder(_name(name), ca.subject, key, end)
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .add_extension(_usage(signs=False), critical=True)
        .add_extension(x509.ExtendedKeyUsage(uses), critical=False)
    )
    if alternatives:
        builder = builder.add_extension(x509.SubjectAlternativeName(alternatives), critical=False)
    return builder.sign(ca_key, hashes.SHA256())


def _builder(subject: x509.Name, issuer: x509.Name, key: _Key, end: datetime.datetime) -> x509.CertificateBuilder:
    # The certificate is valid from yesterday, because the clocks of other hosts may be behind.
    begin = datetime.datetime.now(datetime.UTC) - datetime.timedelta(days=1)
    return (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(begin)
        .not_valid_after(end)
    )


def _usage(signs: bool) -> x509.KeyUsage:
    return x509.KeyUsage(
        digital_signature=True,
        key_cert_sign=signs,
        crl_sign=signs,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        key_agreement=False,
        encipher_only=False,
        decipher_only=False,
    )


def _name(common_name: str) -> x509.Name:
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, common_name)])


def _alternative(host: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ipaddress.ip_address(host))
    except ValueError:
        return x509.DNSName(host)


def _write(directory: Path, name: str, certificate: x509.Certificate, key: _Key) -> None:
    (directory / f"{name}.pem").write_bytes(certificate.public_bytes(serialization.Encoding.PEM))
    with open(os.open(directory / f"{name}.key", os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "wb") as file:
        file.write(
            key.private_bytes(
                serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
            )
        )
