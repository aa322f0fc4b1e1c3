"""The certificate with which the console serves other devices. It is made once, and signed by itself.

A browser warns of it. The person compares the fingerprint that both screens show, and accepts it.
"""

from __future__ import annotations

import datetime
import ipaddress
import os
import socket
from pathlib import Path

import msgspec

VALID = datetime.timedelta(days=397)
"""Browsers refuse certificates that are valid for longer."""
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
    from cryptography import x509
    from cryptography.hazmat.primitives import hashes, serialization
    from cryptography.hazmat.primitives.asymmetric import ec

    file, key_file = folder / f"{name}.pem", folder / f"{name}.key"
    now = datetime.datetime.now(datetime.UTC)
    certificate = x509.load_pem_x509_certificate(file.read_bytes()) if file.exists() and key_file.exists() else None
    if certificate is None or certificate.not_valid_after_utc - now < RENEW:
        key = ec.generate_private_key(ec.SECP256R1())
        try:
            alternative: x509.GeneralName = x509.IPAddress(ipaddress.ip_address(name))
        except ValueError:
            alternative = x509.DNSName(name)
        subject = x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, name)])
        certificate = (
            x509.CertificateBuilder()
            .subject_name(subject)
            .issuer_name(subject)
            .public_key(key.public_key())
            .serial_number(x509.random_serial_number())
            .not_valid_before(now - datetime.timedelta(hours=1))
            .not_valid_after(now + VALID)
            .add_extension(x509.SubjectAlternativeName([alternative]), critical=False)
            .sign(key, hashes.SHA256())
        )
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        private = key.private_bytes(
            serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
        )
        with open(os.open(key_file, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600), "wb") as out:
            out.write(private)
        file.write_bytes(certificate.public_bytes(serialization.Encoding.PEM))
    digest = certificate.fingerprint(hashes.SHA256()).hex(":").upper()
    return Certificate(file, key_file, digest)
