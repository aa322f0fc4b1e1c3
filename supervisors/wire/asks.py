"""Track the requests to a robot that may take effect later.

An arming takes effect when the robot carries it out, not when the wire requests it. A program may still be
uploaded, a login answered, a motor driver started. When a stop overtakes such a request, the robot may be
energised after the safe frame. So the transport notes each request on the shared page (``Owed``). Root and
standby find it there after the wire's death.

    request                                     entry on the page
    passed the check of its permit              under way
    answered, so it has taken effect            nothing
    cut off, refused or failed                  may take effect for ``late_s`` more
    in an SDK's call that hangs                 under way, until the end of this process
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

from strands_actors.contract.wire import ProcessSpent
from strands_actors.kernel.clock import NS, Clock
from strands_actors.supervisors.page import Owed


class Request:
    """One call of the wire that may send a request to the robot."""

    def __init__(self, asks: Asks, late_ns: int, energises: bool) -> None:
        self._asks = asks
        self.late_ns = late_ns
        self.energises = energises
        self.answered = False

    def begin(self) -> None:
        """Note that the request is being sent. A permit calls this when its check passes."""
        self._asks.begin(self)


class Asks:
    """The requests of one wire process. An arming and a service may be under way together."""

    def __init__(self, owed: Owed, clock: Clock) -> None:
        self._owed = owed
        self._clock = clock
        self._under_way: set[Request] = set()
        self._until_ns = 0  # when the last request that was cut off can no longer take effect

    @contextlib.contextmanager
    def asking(self, late_s: float, energises: bool = True) -> Iterator[Request]:
        """Wrap one call of the wire that may send a request to the robot.

        Args:
            late_s: Longest time after a cut-off in which the request may still take effect.
            energises: True if the request may leave the robot energised.

        Yields:
            The request. Set ``answered`` when the call has succeeded. Otherwise it counts as cut off.
        """
        request = Request(self, round(late_s * NS), energises)
        try:
            yield request
        except ProcessSpent:
            raise  # A thread of an SDK may still carry it out, until this process ends.
        except BaseException:
            self._end(request, answered=False)
            raise
        self._end(request, request.answered)

    def begin(self, request: Request) -> None:
        if request.energises:
            self._owed.safe_state = True
        if request.late_ns and request not in self._under_way:
            self._under_way.add(request)
            self._note()

    def _end(self, request: Request, answered: bool) -> None:
        if request in self._under_way:
            self._under_way.remove(request)
            if not answered:
                self._until_ns = max(self._until_ns, self._clock.now_ns() + request.late_ns)
            self._note()

    def _note(self) -> None:
        if self._under_way:
            left_ns = self._until_ns - self._clock.now_ns()
            self._owed.ask(max(left_ns, *(request.late_ns for request in self._under_way)))
        else:
            self._owed.settle_at(self._until_ns)
