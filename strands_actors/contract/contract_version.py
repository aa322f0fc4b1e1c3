"""Decide by the version of the driver contract whether this package can run a driver of another package."""

from __future__ import annotations

from typing import Any

CONTRACT_VERSION = 1
"""The newest version of the driver contract that this package supports."""

OLDEST_CONTRACT_VERSION = 1
"""The oldest version of the driver contract that this package supports."""

UNDECLARED = 1
"""The version of a driver class that declares no version. It stays 1 in all later releases."""


def unsupported_contract(cls: type[Any]) -> str:
    """Return why this package cannot run a driver class, by the ``CONTRACT_VERSION`` that the class declares.

    Args:
        cls: A subclass of ``Driver``, or a plain driver class. A class without ``CONTRACT_VERSION`` has version 1.

    Returns:
        The reason and what to do. Empty if this package supports the version.
    """
    version = getattr(cls, "CONTRACT_VERSION", UNDECLARED)
    if isinstance(version, bool) or not isinstance(version, int):
        return f"{cls.__name__}.CONTRACT_VERSION is {version!r}. Declare a whole number, such as {CONTRACT_VERSION}"
    if OLDEST_CONTRACT_VERSION <= version <= CONTRACT_VERSION:
        return ""
    supported = f"version {CONTRACT_VERSION}"
    if OLDEST_CONTRACT_VERSION < CONTRACT_VERSION:
        supported = f"versions {OLDEST_CONTRACT_VERSION} to {CONTRACT_VERSION}"
    if version > CONTRACT_VERSION:
        remedy = "Install a newer release of strands-actors, or an older release of the driver"
    else:
        remedy = "Install a newer release of the driver, or an older release of strands-actors"
    return (
        f"{cls.__name__} was written for version {version} of the driver contract, but this release of "
        f"strands-actors supports {supported}. {remedy}"
    )
