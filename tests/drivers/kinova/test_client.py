"""Test which responses the client of a base accepts, without a base."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import pytest
import trio

from strands_actors.contract.wire import WireDown
from strands_actors.drivers.kinova.client import MAX_OPEN, CallRefused, KortexClient
from strands_actors.drivers.kinova.protocol import Call, Decoder, Frame, Kind, SubError
from strands_actors.kernel.clock import VirtualClock
from tests.drivers.common.memory_port import MemoryPort, virtual

SPEEDS = Call.SEND_JOINT_SPEEDS


def client_of(respond: Callable[[Frame], Iterable[Frame]]) -> KortexClient:
    """Return a client. ``respond`` gives the frames that the base sends after a request."""

    def peer(data: bytes) -> Iterable[tuple[float, bytes]]:
        for request in Decoder().feed(data):
            yield 0.001, b"".join(frame.encode() for frame in respond(request))

    return KortexClient(MemoryPort(peer), "the base", VirtualClock())


def response(request: Frame, call: int, payload: bytes = b"", error: int = 0) -> Frame:
    return Frame(Kind.RESPONSE, call, request.message, request.session, payload, error, SubError.ROBOT_IN_FAULT)


def test_only_the_response_with_number_and_function_of_the_request_counts() -> None:
    def respond(request: Frame) -> Iterable[Frame]:
        yield Frame(Kind.NOTIFICATION, request.call, request.message, 0, b"a notification")
        yield response(request, Call.STOP, b"of another function")
        yield Frame(Kind.RESPONSE, request.call, request.message + 1, 0, b"of another request")
        yield response(request, request.call, b"right")
        yield response(request, request.call, b"the second")

    async def main() -> None:
        client = client_of(respond)
        assert (await client.call(Call.GET_SERVOING_MODE)).payload == b"right"
        assert (await client.call(Call.GET_ACTUATOR_COUNT)).payload == b"right"

    virtual(main)


@pytest.mark.parametrize("call", [SPEEDS, Call.KEEP_ALIVE])
def test_a_refusal_is_noted_only_of_speeds_for_which_no_caller_waits(call: Call) -> None:
    async def main() -> None:
        client = client_of(lambda request: [response(request, request.call, error=1)])
        with pytest.raises(CallRefused, match="refuses"):
            await client.call(call)
        assert client.refusal is None
        client.tell(call)
        await client.listen(client.ask(Call.REFRESH_FEEDBACK), 0.1)
        assert (client.refusal is not None) == (call == SPEEDS)

    virtual(main)


def test_the_memory_is_bounded_and_the_base_is_silent_if_no_response_comes() -> None:
    async def main() -> None:
        client = client_of(lambda request: [])
        for _ in range(3 * MAX_OPEN):
            client.tell(SPEEDS)
        assert client._exchange.unanswered == MAX_OPEN
        await client.listen(client.ask(SPEEDS), 0.4)
        with pytest.raises(WireDown, match="did not answer for"):
            await client.listen(client.ask(SPEEDS), 0.2)
        await trio.sleep(5.0)
        await client.listen(client.ask(SPEEDS), 0.4)

    virtual(main)
