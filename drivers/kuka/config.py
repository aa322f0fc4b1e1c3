"""The immutable settings of a KUKA arm, and the UDP port on which a process talks to the controller.

The wire process and the stop channel use the same settings.
"""

from __future__ import annotations

from ipaddress import IPv4Address

import msgspec

from strands_actors.contract.wire import WireDown
from strands_actors.drivers.common.ports.addresses import parse_address
from strands_actors.drivers.common.ports.udp_port import UdpListener, listen_udp

from .robots import Arm


class KukaConfig(msgspec.Struct, frozen=True):
    arm: Arm
    port: str
    fri_port: int
    connect_timeout_s: float
    stream_ttl_s: float

    def address(self) -> tuple[str, int]:
        """Return the controller's address and the UDP port, which is the same at both ends.

        An empty address means any controller. The UDP port is the one in ``port``, or else ``fri_port``.

        Raises:
            ValueError: ``port`` is not an address.
        """
        return parse_address(self.port, self.fri_port) if self.port else ("", self.fri_port)

    def numeric_host(self) -> str:
        """Return the controller's IPv4 address. Empty if ``port`` has a host name or no address."""
        try:
            return str(IPv4Address(self.address()[0]))
        except ValueError:
            return ""

    async def listen(self) -> UdpListener:
        """Open the UDP port. Raise ``WireDown``."""
        try:
            host, number = self.address()
        except ValueError as error:
            raise WireDown(f"open: {error}") from None
        return await listen_udp(number, host)


class KeptPort:
    """The UDP port of the wire process. It stays open when the wire reconnects.

    The supervising process (root) has a duplicate of its socket. While this duplicate is open, no second socket can
    be bound to the port.
    """

    def __init__(self, config: KukaConfig) -> None:
        self._config = config
        self._port: UdpListener | None = None

    async def get(self) -> UdpListener:
        """Return the open UDP port. Open it first if needed. Raise ``WireDown`` if that fails."""
        if self._port is None:
            self._port = await self._config.listen()
        return self._port

    def release(self) -> None:
        """Close the port now, not only at the end of the process."""
        if self._port is not None:
            self._port.close()
            self._port = None
