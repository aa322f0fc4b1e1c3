"""Match a peer's answers to the requests that were sent to it, by number.

The owner of an ``Exchange`` writes each request itself, at once, and reports it to ``sent``. So a stop never waits
for earlier answers. Several callers may wait for answers at the same time. One of them reads for all, and hands
each answer to ``take``. An answer is dropped if there was no request, if it comes twice, or if its caller has
left::

    number = next(self._numbers)
    self._stream.write(encode(number, method))
    self._exchange.sent(number, method, awaited=True)
    try:
        answer = await self._exchange.answer(number, ANSWER_S, self._receive)
    finally:
        self._exchange.forget(number)

This module has no clock and no I/O: the owner gives the times, and the function that receives data. Some protocols
do not fit, because a request has no number or does not have exactly one answer:

* HTTP (``http_port``): answers have no number, and come in the order of the requests.
* Serial buses (``half_duplex``), the socket of simulations: there is one request at a time.
* gRPC, with Spot and RB-Y1: HTTP/2 numbers the calls, and a call has any number of messages and a final status.
* Pings of a WebSocket: a pong answers all earlier pings.
* Franka: the request for a motion is answered at its start and at its end.
* Crazyflie: an answer has no number, and a lost request is repeated.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Hashable, Iterator
from typing import Generic, NamedTuple, TypeVar

import trio

from strands_actors.contract.wire import WireDown
from strands_actors.kernel.clock import NS

MOST = 4096
"""Number of requests to remember, and of answers that were not fetched yet. A new one replaces the oldest."""

PAUSE_S = 0.5
"""After a pause of this length without a request, the silence of the peer counts from the next request. Otherwise a
single lost answer would make the peer look silent."""

Key = TypeVar("Key", bound=Hashable)
RequestT = TypeVar("RequestT")
AnswerT = TypeVar("AnswerT")

Receive = Callable[[], Awaitable[None]]
"""Wait for data of the peer, and hand each answer in it to ``Exchange.take``. Raise ``WireDown`` if the connection
is lost or closed."""


def numbers(last: int) -> Iterator[int]:
    """Yield the numbers of requests without end: 1 to ``last``, then 1 again."""
    while True:
        yield from range(1, last + 1)


class Sent(NamedTuple, Generic[RequestT]):
    """A request without an answer.

    Attributes:
        request: The argument ``request`` of ``Exchange.sent``.
        sent_ns: Time at which it was sent.
        is_awaited: True if a caller will fetch the answer.
    """

    request: RequestT
    sent_ns: int
    is_awaited: bool


class Exchange(Generic[Key, RequestT, AnswerT]):
    """The requests to one peer, and its answers.

    Args:
        most: Number of requests to remember. A new one replaces the oldest, and then the answer to the oldest is
            dropped.
    """

    def __init__(self, most: int = MOST) -> None:
        self._most = most
        self._sent: dict[Key, Sent[RequestT]] = {}  # the requests without an answer, oldest first
        self._answers: dict[Key, AnswerT] = {}  # the awaited answers that have arrived, oldest first
        self._silent_since_ns = self._last_sent_ns = 0
        self._is_reading = False
        self._others = trio.lowlevel.ParkingLot()  # the callers that wait for the one that reads

    @property
    def unanswered(self) -> int:
        """The number of requests without an answer."""
        return len(self._sent)

    # -- the owner's side

    def sent(self, key: Key, request: RequestT, now_ns: int = 0, *, awaited: bool = False) -> None:
        """Note a request that was sent.

        Args:
            key: The number of the request. If it was used before, the earlier request is dropped.
            request: Anything that the owner needs when the answer comes.
            now_ns: The time. Needed for ``silent_s`` and ``expire`` only.
            awaited: Keep the answer until ``pop`` or ``forget`` is called.
        """
        self.drop(key)
        if not self._sent or now_ns - self._last_sent_ns > PAUSE_S * NS:
            self._silent_since_ns = now_ns
        self._last_sent_ns = now_ns
        if len(self._sent) >= self._most:
            self.drop(next(iter(self._sent)))
        self._sent[key] = Sent(request, now_ns, awaited)

    def request(self, key: Key) -> RequestT | None:
        """Return the unanswered request with this number; None if there is no such request."""
        sent = self._sent.get(key)
        return None if sent is None else sent.request

    def take(self, key: Key, answer: AnswerT) -> Sent[RequestT] | None:
        """Take an answer of the peer.

        Returns:
            Its request; None if no request with this number waits for an answer. The answer is then dropped.
        """
        sent = self._sent.pop(key, None)
        if sent is not None and sent.is_awaited:
            if len(self._answers) >= self._most:
                del self._answers[next(iter(self._answers))]
            self._answers[key] = answer
        return sent

    def received(self, now_ns: int) -> None:
        """Note that the peer has sent something, so that it is not silent."""
        self._silent_since_ns = now_ns

    def silent_s(self, now_ns: int) -> float:
        """Return for how long the peer has been silent although it was asked; 0 if no request waits."""
        return (now_ns - self._silent_since_ns) / NS if self._sent else 0.0

    def expire(self, before_ns: int) -> None:
        """Drop the requests that were sent before a time and that no caller waits for. Their answers are lost."""
        for key in [key for key, sent in self._sent.items() if sent.sent_ns < before_ns and not sent.is_awaited]:
            del self._sent[key]

    def drop(self, key: Key) -> None:
        """Drop a request and its answer, as if the request had not been sent."""
        self._sent.pop(key, None)
        self._answers.pop(key, None)

    def clear(self) -> None:
        """Drop all requests and answers, because the connection has ended. All that wait are woken up."""
        self._sent.clear()
        self._answers.clear()
        self._others.unpark_all()

    # -- the callers' side

    def waits_for(self, key: Key) -> bool:
        """Return True if the answer to this request is awaited and has not arrived."""
        sent = self._sent.get(key)
        return sent is not None and sent.is_awaited

    def pop(self, key: Key) -> AnswerT | None:
        """Return the answer to a request if it has arrived, else None. Never waits."""
        return self._answers.pop(key, None)

    def forget(self, key: Key) -> None:
        """Do not wait for the answer to a request any more. The request still counts as unanswered."""
        self._answers.pop(key, None)
        if key in self._sent:
            self._sent[key] = self._sent[key]._replace(is_awaited=False)

    async def answer(self, key: Key, within_s: float, receive: Receive) -> AnswerT | None:
        """Wait for the answer to a request. Call ``forget`` if the answer is not wanted any more.

        Args:
            key: The number of the request.
            within_s: Longest wait.
            receive: Receives data once.

        Returns:
            The answer; None if it has not arrived in time. A later call can then wait for it again.

        Raises:
            WireDown: The connection was lost or replaced before the answer came.
        """
        await self.wait(within_s, receive, key)
        answer = self.pop(key)
        if answer is None and not self.waits_for(key):
            raise WireDown("the connection was lost before the answer. Reconnect")
        return answer

    async def wait(self, within_s: float, receive: Receive, *keys: Key) -> None:
        """Wait until one of several requests is not waited for any more, because it is answered, dropped or
        forgotten. Return also after ``within_s``. Raise ``WireDown`` if the connection is lost."""
        with trio.move_on_after(within_s):
            await self.until(lambda: not all(map(self.waits_for, keys)), receive)

    async def until(self, is_so: Callable[[], bool], receive: Receive) -> None:
        """Receive data until ``is_so()`` is true. If another caller receives already, wait for it.

        Raises:
            WireDown: The connection is lost.
        """
        while not is_so():
            if self._is_reading:
                await self._others.park()
                continue
            self._is_reading = True
            try:
                await receive()
            finally:
                # One of the others must read next, even if this caller was cancelled.
                self._is_reading = False
                self._others.unpark_all()
