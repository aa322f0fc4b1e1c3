"""Read the common name in a certificate, which identifies its holder on the mesh.

Robots and scripts need only this field, so this module reads it without a library for certificates.
"""

from __future__ import annotations

import binascii
import re
from collections.abc import Iterator

_PEM = re.compile(rb"-----BEGIN CERTIFICATE-----(.*?)-----END CERTIFICATE-----", re.DOTALL)
_COMMON_NAME = bytes((0x55, 0x04, 0x03))  # The object identifier 2.5.4.3, in DER.
_EXPLICIT_VERSION = 0xA0
_SUBJECT_AT = 4
"""Index of the subject, after serial number, algorithm, issuer and validity (RFC 5280, 4.1)."""
MAX_BYTES = 64 * 1024


def common_name(path: str) -> str:
    """Return the common name of the first certificate in a PEM file.

    Raises:
        ValueError: The file has no certificate with a common name.
        OSError: The file cannot be read.
    """
    with open(path, "rb") as file:
        match = _PEM.search(file.read(MAX_BYTES))
    if match is None:
        raise ValueError(f"{path} is not a certificate in PEM format")
    try:
        return _common_name(binascii.a2b_base64(match.group(1)))
    except (ValueError, IndexError, StopIteration) as error:
        raise ValueError(
            f"{path} is not a certificate with a common name ({error or 'the file is cut off'})"
        ) from None


def _common_name(der: bytes) -> str:
    (_, certificate), *_ = _elements(der)
    (_, signed), *_ = _elements(certificate)
    fields = list(_elements(signed))
    if fields[0][0] == _EXPLICIT_VERSION:
        del fields[0]
    for _, group in _elements(fields[_SUBJECT_AT][1]):
        for _, pair in _elements(group):
            (_, attribute), (_, value), *_ = _elements(pair)
            if attribute == _COMMON_NAME:
                return value.decode()
    raise ValueError("the common name is missing")


def _elements(data: bytes) -> Iterator[tuple[int, bytes]]:
    """Yield the tag and the content of each element of a DER sequence (the binary form of a certificate)."""
    index = 0
    while index < len(data):
        tag, length = data[index], data[index + 1]
        index += 2
        if length & 0x80:
            count = length & 0x7F
            length = int.from_bytes(data[index : index + count], "big")
            index += count
        if index + length > len(data):
            raise ValueError("cut off")
        yield tag, data[index : index + length]
        index += length
