"""Track the requests to a robot that may take effect later.

An arming takes effect when the robot carries it out, not when the wire process sends it. The robot may still load a
program, answer a login, or start a motor driver. If a stop comes meanwhile, the robot may be energised after the
stop. So the transport notes each request on the shared page (``SafetyPage``). Root and standby read it there after
the wire process has died.

    state of the request                        entry on the page
    its last check (permit) has passed          running
    answered, so it has taken effect            nothing
    cut off, refused or failed                  may take effect for ``late_s`` more
    in a call of an SDK that hangs              running, until this process ends
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

from strands_actors.contract.wire import ProcessSpent
from strands_actors.kernel.clock import NS, Clock
from strands_actors.supervisors.page import SafetyPage


class Request:
    """One call of the wire that may send a request to the robot, such as an arming."""

    def __init__(self, late_requests: LateRequests, late_ns: int, energises: bool) -> None:
        self._late_requests = late_requests
        self.late_ns = late_ns
        self.energises = energises
        self.answered = False

    def begin(self) -> None:
        """Note that the request is being sent. The permit (the last check before sending) calls this when the
        request may be sent."""
        self._late_requests.begin(self)


class LateRequests:
    """All requests of one wire process that may take effect later. An arming and a service may run at the same
    time."""

    def __init__(self, safety_page: SafetyPage, clock: Clock) -> None:
        self._safety_page = safety_page
        self._clock = clock
        self._running: set[Request] = set()
        self._until_ns = 0  # when the last request that was cut off can no longer take effect

    @contextlib.contextmanager
    def asking(self, late_s: float, energises: bool = True) -> Iterator[Request]:
        """Run one call of the wire that may send a request to the robot, as a ``with`` block.

        Args:
            late_s: If the request is cut off, it may still take effect for this long.
            energises: True if the request may energise the robot.

        Yields:
            The request. Set its ``answered`` when the call has succeeded. Otherwise the request counts as cut off.
        """
        request = Request(self, round(late_s * NS), energises)
        try:
            yield request
        except ProcessSpent:
            # A thread of the SDK may still carry out the request until this process ends, so it stays on the page.
            raise
        except BaseException:
            self._end(request, answered=False)
            raise
        self._end(request, request.answered)

    def begin(self, request: Request) -> None:
        if request.energises:
            self._safety_page.may_be_energised = True
        if request.late_ns and request not in self._running:
            self._running.add(request)
            self._note()

    def _end(self, request: Request, answered: bool) -> None:
        if request in self._running:
            self._running.remove(request)
            if not answered:
                self._until_ns = max(self._until_ns, self._clock.now_ns() + request.late_ns)
            self._note()

    def _note(self) -> None:
        if self._running:
            remaining_ns = self._until_ns - self._clock.now_ns()
            self._safety_page.ask(max(remaining_ns, *(request.late_ns for request in self._running)))
        else:
            self._safety_page.settle(self._until_ns)
