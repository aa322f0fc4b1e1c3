"""Simulate a Spot: its services on one port, behind TLS, with a clock that is two minutes
ahead. The address contains the path of the certificate to trust: ``127.1.2.3:40000?ca=PATH``.

Control lines of this simulated robot: ``steal NAME`` takes the lease, ``press`` and ``release``
operate its e-stop button, ``fall`` lets it fall, ``break NAME`` breaks a part of its hardware,
``repair`` repairs all, ``mute METHOD ...`` suppresses the answers of these methods.
"""

from __future__ import annotations

import time
from typing import Annotated

import trio

from strands_actors.contract.options import option
from strands_actors.drivers.common.twin import (
    Connection,
    NetworkOptions,
    TcpServer,
    WireLog,
    main_of,
)
from strands_actors.drivers.spot.config import TWIN_LOGIN

from .login import LoginHost
from .mechanism import Mechanism
from .requests import COMMANDS, METHODS
from .services import SKEW_S, SpotTwin
from .tls import TlsConnection, certificate, server_context

MODELLED = (METHODS, COMMANDS)


class SpotTwinOptions(NetworkOptions, frozen=True):
    skew_s: Annotated[float, option("seconds that its clock is ahead of the host's")] = SKEW_S
    sync_s: Annotated[float, option("seconds that its time sync takes", ge=0)] = 0.0
    arm: Annotated[bool, option("whether it has one")] = True
    user: Annotated[str, option("the only user who may log in")] = TWIN_LOGIN[0]
    password: Annotated[str, option("the user's password")] = TWIN_LOGIN[1]
    haste: Annotated[float, option("how many times faster than a robot it powers on, stands, sits", gt=0)] = 1.0


_TICK_S = 0.01


class SpotServer(TcpServer):
    """Serve one simulated Spot on one port."""

    def __init__(self, twin: SpotTwin, port: int, log: WireLog, host: str | None) -> None:
        self._twin = twin
        self._clients = LoginHost(twin, twin.logins)
        self._context = server_context()
        super().__init__(twin, {port: self._handle}, log, host)

    @property
    def address(self) -> str:
        return f"{super().address}?ca={certificate('ca.pem')}"

    def start(self, nursery: trio.Nursery) -> None:
        super().start(nursery)
        nursery.start_soon(self._frost.every, _TICK_S, self._tick)

    def _tick(self) -> None:
        self._twin.pass_time()
        self._clients.flush()

    async def _handle(self, connection: Connection) -> None:
        tls = TlsConnection(connection, self._context)
        await tls.shake_hands()
        await self._clients.serve(tls)


def build(robot: str, options: SpotTwinOptions, log: WireLog) -> SpotServer:
    """Return the server of a robot of ``robots.toml``."""
    twin = SpotTwin(
        robot,
        time.monotonic,
        skew_s=options.skew_s,
        sync_s=options.sync_s,
        arm=options.arm,
        user=options.user,
        password=options.password,
        haste=options.haste,
    )
    return SpotServer(twin, options.port, log, options.host)


main = main_of(SpotTwinOptions, build)

__all__ = ["MODELLED", "Mechanism", "SpotServer", "SpotTwin", "build", "main"]
