"""The frozen settings that the wire and the stop channel share, and the UDP port of a process."""

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
        """Return the controller's address, empty for any, and the UDP port of both ends.

        The UDP port is the one in ``port``, or else ``fri_port``.

        Raises:
            ValueError: ``port`` is not an address.
        """
        return parse_address(self.port, self.fri_port) if self.port else ("", self.fri_port)

    def numeric_host(self) -> str:
        """Return the controller's address if it is given as a number. Empty if it would have to be resolved."""
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
    """The UDP port of this process, kept from one wire to the next. The root has a duplicate of its socket,
    and a second socket could not be bound beside that."""

    def __init__(self, config: KukaConfig) -> None:
        self._config = config
        self._port: UdpListener | None = None

    async def get(self) -> UdpListener:
        """Return the port, and open it first if needed. Raise ``WireDown``."""
        if self._port is None:
            self._port = await self._config.listen()
        return self._port

    def release(self) -> None:
        """Close the port before the end of the process does."""
        if self._port is not None:
            self._port.close()
            self._port = None
