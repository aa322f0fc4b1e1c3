"""An HTTP client for a wire process: httpx on trio, one kept connection, a deadline on every
request.

A request that may move a robot takes a permit. It is checked as the last thing before the head
leaves, after any wait for a connection, and once more before the body does. Nothing is queued,
repeated or redirected; no proxy of the environment is used. What is not sent now is never sent.
Never imported by a root process: what stops or moves a robot goes by ``http_port``.
"""

from __future__ import annotations

import socket
import ssl
import struct
from collections.abc import Mapping
from typing import Any

import httpx
import trio

from strands_actors.contract.wire import Permit, WireDown

from .http_messages import MAX_BODY

CONNECT_S = 0.2
"""Within a local network."""

_HEAD, _BODY = "http11.send_request_headers.started", "http11.send_request_body.started"
_SENT = "http11.send_request_body.complete"

_SOCKET_OPTIONS: list[tuple[int, int, int] | tuple[int, int, bytes | bytearray]] = [
    (socket.IPPROTO_TCP, socket.TCP_NODELAY, 1),
    (socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0)),  # as ``tcp_port``: closed with a reset
]


_NO_TLS = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
"""It trusts nobody: services are asked by plain HTTP, and reading the system's certificates takes
50 ms."""


class HttpClient:
    """For one service. ``base_url``: ``http://host:port``."""

    def __init__(self, base_url: str) -> None:
        self._name = base_url
        transport = httpx.AsyncHTTPTransport(
            limits=httpx.Limits(max_connections=1, max_keepalive_connections=1),
            socket_options=_SOCKET_OPTIONS,
            verify=_NO_TLS,
            trust_env=False,
        )
        self._client = httpx.AsyncClient(
            base_url=base_url, transport=transport, trust_env=False, follow_redirects=False
        )

    async def get(self, target: str, within_s: float) -> httpx.Response:
        """Return the response, whatever its status. Raise ``WireDown``."""
        return await self._ask(httpx.Request("GET", f"{self._name}{target}"), within_s, None)

    async def post(
        self,
        target: str,
        body: bytes,
        within_s: float,
        permit: Permit | None = None,
        task_status: trio.TaskStatus[None] = trio.TASK_STATUS_IGNORED,
        *,
        kind: str = "application/json",
    ) -> httpx.Response:
        """As ``get``. ``started`` when all of it has left. Raise ``PermitDenied``, too."""
        request = httpx.Request("POST", f"{self._name}{target}", content=body, headers={"Content-Type": kind})
        return await self._ask(request, within_s, permit, task_status)

    async def aclose(self) -> None:
        await self._client.aclose()

    async def _ask(
        self,
        request: httpx.Request,
        within_s: float,
        permit: Permit | None,
        task_status: trio.TaskStatus[None] = trio.TASK_STATUS_IGNORED,
    ) -> httpx.Response:
        async def trace(event: str, info: Mapping[str, Any]) -> None:
            if permit is not None and (event == _HEAD or (event == _BODY and request.content)):
                permit.check()
            elif event == _SENT:
                task_status.started()

        waits = httpx.Timeout(within_s, connect=min(CONNECT_S, within_s))
        request.extensions = {"trace": trace, "timeout": waits.as_dict()}
        try:
            with trio.fail_after(within_s):
                response = await self._client.send(request, stream=True)
                try:
                    return await self._whole(response)
                finally:
                    await response.aclose()
        except trio.TooSlowError:
            why = f"no answer within {within_s * 1e3:.0f} ms"
        except httpx.HTTPError as error:
            why = str(error) or type(error).__name__
        raise WireDown(f"{self._name}: {why}. Check the service and its network")

    async def _whole(self, response: httpx.Response) -> httpx.Response:
        """Return it with its body, which is bounded."""
        body = bytearray()
        async for part in response.aiter_bytes():
            body += part
            if len(body) > MAX_BODY:
                raise WireDown(f"{self._name}: answer of more than {MAX_BODY} bytes. Check what is served there")
        return httpx.Response(response.status_code, content=bytes(body))
