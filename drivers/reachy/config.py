"""What the wire and the stop channel of a Reachy Mini know of it."""

from __future__ import annotations

import os

import msgspec

from strands_actors.drivers.common.tcp_port import parse_address

_LONGEST = 1024
"""Bytes of a place."""


LATE_S = 1.5
"""A request of a client that was killed may be carried out so late [assumed: the daemon takes as long to
switch the motors]. The root asks on connections of its own, and may overtake it."""


def tell_place(host: str, number: int) -> int:
    """Return a descriptor of memory that says where the daemon was found, for ``at_told``."""
    told = os.memfd_create("reachy")
    os.pwrite(told, f"[{host}]:{number}".encode(), 0)
    return told


class ReachyConfig(msgspec.Struct, frozen=True):
    robot: str
    port: str
    """Empty: whoever of ``places`` answers first."""
    places: tuple[str, ...]
    axes: tuple[str, ...]
    ids: tuple[int, ...]
    yaw_deg: float
    api_port: int
    media_port: int
    tts_url: str
    silent_s: float = 1.0
    """Without a frame for so long the link counts as lost."""

    def addresses(self) -> tuple[tuple[str, int], ...]:
        """Return where the daemon may be. Raise ``ValueError`` for a ``port`` that is no address of
        a service."""
        return tuple(self._address(place) for place in ((self.port,) if self.port else self.places))

    def at_told(self, told: int) -> ReachyConfig:
        """Return it with the one place that ``tell_place`` told. Closes the descriptor."""
        try:
            return msgspec.structs.replace(self, port=os.pread(told, _LONGEST, 0).decode())
        finally:
            os.close(told)

    def _address(self, place: str) -> tuple[str, int]:
        scheme, found, rest = place.partition("://")
        if not found:
            scheme, rest = "http", place
        rest = rest.removesuffix("/")
        if scheme != "http" or not rest or any(sign in rest for sign in "/?#@ "):
            raise ValueError(
                f"port is {place!r}. Give the address of the daemon: 192.0.2.10:{self.api_port} or "
                f"http://192.0.2.10:{self.api_port}, without a user or a path. It speaks no https"
            )
        return parse_address(rest, self.api_port)
