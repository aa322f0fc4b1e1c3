"""What the wire and the stop channel of a Reachy Mini know of it."""

from __future__ import annotations

import msgspec

from strands_actors.drivers.common.tcp_port import parse_address


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
