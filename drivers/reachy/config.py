"""What the wire and the stop channel of a Reachy Mini know of it."""

from __future__ import annotations

import os
from urllib.parse import urlsplit

import msgspec

from strands_actors.drivers.common.addresses import parse_web_address

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


def parse_speech_url(url: str) -> tuple[str, int, str]:
    """Return host, port and target of ``tts_url``. Raise ``ValueError`` for what is no http
    address."""
    parts = urlsplit(url)
    if parts.scheme != "http" or not parts.hostname or parts.username is not None:
        raise ValueError(f"tts_url is {url!r}. Give an address that begins with http://, without a user")
    target = (parts.path or "/") + (f"?{parts.query}" if parts.query else "")
    if not target.isascii() or " " in target:
        raise ValueError(f"tts_url is {url!r}. Write what is not ASCII, and spaces, with percent signs")
    return parts.hostname, parts.port or 80, target


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
        return parse_web_address(place, self.api_port, "the daemon")
