"""The certificate with which the console serves other devices. It is made once, and signed by itself.

A browser warns of it. The person compares the fingerprint that both screens show, and accepts it.
"""

from __future__ import annotations

import datetime
import socket
from pathlib import Path

import msgspec

VALID_DAYS = 396
"""Browsers refuse certificates that are valid for more than 398 days. One is valid from the day before."""
RENEW = datetime.timedelta(days=30)
_OUTSIDE = ("192.0.2.1", 9)
"""An address for documentation (RFC 5737). Nothing is sent to it."""


class Certificate(msgspec.Struct, frozen=True):
    """A certificate with its key, as PEM files.

    Attributes:
        file: The certificate.
        key: Its key, which only this user can read.
        fingerprint: Its SHA-256, as browsers show it.
    """

    file: Path
    key: Path
    fingerprint: str


def own_name() -> str:
    """Return the address of this computer in its network; its loopback address without one."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(_OUTSIDE)
        except OSError:
            return "127.0.0.1"
        address: str = probe.getsockname()[0]
        return address


def certificate_for(name: str, folder: Path) -> Certificate:
    """Return the certificate for a name. Make it if it is missing, or ends soon.

    Args:
        name: Name or IP address of this computer.
        folder: Folder for certificate and key.
    """
    # Only a server for other devices needs the library.
    from cryptography import x509
    from cryptography.hazmat.primitives import hashes

    from strands_actors.surfaces.mesh.keys import make_own

    file, key = folder / f"{name}.pem", folder / f"{name}.key"
    certificate = x509.load_pem_x509_certificate(file.read_bytes()) if file.exists() and key.exists() else None
    now = datetime.datetime.now(datetime.UTC)
    if certificate is None or certificate.not_valid_after_utc - now < RENEW:
        certificate = make_own(folder, name, VALID_DAYS)
    return Certificate(file, key, certificate.fingerprint(hashes.SHA256()).hex(":").upper())
