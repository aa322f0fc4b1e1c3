"""Settings of a Reachy Mini, shared by the process that drives it (the wire) and the supervising process (root),
which can also stop it. The wire process also passes the address of the daemon to the root process."""

from __future__ import annotations

import os
from urllib.parse import urlsplit

import msgspec

from strands_actors.drivers.common.ports.addresses import parse_web_address

_LONGEST = 1024
"""Most bytes of an address."""


LATE_S = 1.5
"""A request of a killed client may take effect this late [assumed: the daemon takes as long to switch the
motors]. The root uses separate connections, so its requests may overtake it."""


def publish_address(host: str, number: int) -> int:
    """Write the daemon's address into memory that another process can read with ``with_published_address``.
    Return its file descriptor."""
    memory = os.memfd_create("reachy")
    os.pwrite(memory, f"[{host}]:{number}".encode(), 0)
    return memory


def parse_speech_url(url: str) -> tuple[str, int, str]:
    """Return host, port and target of ``tts_url``. Raise ``ValueError`` if it is not an http address."""
    parts = urlsplit(url)
    if parts.scheme != "http" or not parts.hostname or parts.username is not None:
        raise ValueError(f"tts_url is {url!r}. Give an address that begins with http://, without a user")
    target = (parts.path or "/") + (f"?{parts.query}" if parts.query else "")
    if not target.isascii() or " " in target:
        raise ValueError(f"tts_url is {url!r}. Percent-encode its spaces and non-ASCII characters")
    return parts.hostname, parts.port or 80, target


class ReachyConfig(msgspec.Struct, frozen=True):
    robot: str
    port: str
    """The daemon's address. If empty, the first of ``places`` that answers is used."""
    places: tuple[str, ...]
    axes: tuple[str, ...]
    ids: tuple[int, ...]
    yaw_deg: float
    api_port: int
    media_port: int
    tts_url: str
    silent_s: float = 1.0
    """The link counts as lost after this long without a frame."""

    def addresses(self) -> tuple[tuple[str, int], ...]:
        """Return the addresses at which the daemon may be. Raise ``ValueError`` if ``port`` is not an address."""
        return tuple(self._address(place) for place in ((self.port,) if self.port else self.places))

    def with_published_address(self, descriptor: int) -> ReachyConfig:
        """Return a copy of the settings whose only address is the one that ``publish_address`` wrote. Close the
        descriptor."""
        try:
            return msgspec.structs.replace(self, port=os.pread(descriptor, _LONGEST, 0).decode())
        finally:
            os.close(descriptor)

    def _address(self, place: str) -> tuple[str, int]:
        return parse_web_address(place, self.api_port, "the daemon")
