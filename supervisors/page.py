"""A page of shared memory of one robot. Its root, wire and standby processes write and read these words:

    words          written by       read by         content
    heartbeats     each process     the others      the time of the last heartbeat
    energised      wire, root       standby, root   1 if something may be energised
    silent         wire             standby         until when the wire may send no heartbeat
    ordered        each process     each process    the most severe safe state that is not confirmed yet
    stopped        root             wire            when the root was last ordered to stop the robot
    wire pid       root             standby         the wire process that was started last
    late           wire             root, standby   a request that may still take effect

These facts are in shared memory and not in messages, because a process that acts after another one has died can no
longer ask it. The standby (the third process, which stops the robot when root and wire have ended) acts only if
something may be energised. It brings the robot to the safe state that was ordered last, and repeats it while a
request of the wire may still take effect.
"""

from __future__ import annotations

from strands_actors.contract.safe_state import SafeState
from strands_actors.kernel.clock import NS
from strands_actors.kernel.health.heartbeat import Word, private_page

ROOT, WIRE, STANDBY = range(3)
"""Indices of the heartbeats."""
_ENERGISED, _SILENT, _ORDERED, _STOPPED, _WIRE_PID, _LATE = 3, 4, 5, 6, 7, 8
_BY_SEVERITY = tuple(SafeState)


class SafetyPage:
    """Access to a page of shared memory with the orders and requests that are still open, for example an e-stop
    that is not confirmed yet.

    Args:
        words: The memory of the page; None for a page that only this process uses.
    """

    def __init__(self, words: memoryview | None = None) -> None:
        page = private_page() if words is None else words
        self._energised = Word(page, _ENERGISED)
        self._silent = Word(page, _SILENT)
        # Severity of the ordered safe state; 0 without an order, or for the mildest state.
        self._ordered = Word(page, _ORDERED)
        self._stopped = Word(page, _STOPPED)
        self._wire_pid = Word(page, _WIRE_PID)
        # A negative value means that a request is running. After it is cut off, it may take effect for that many
        # nanoseconds. A positive value means that a request was cut off and may take effect until this time. 0
        # means neither.
        self._late = Word(page, _LATE)

    @property
    def may_be_energised(self) -> bool:
        """True if something may be energised. It is set before an arming, and cleared when every motor has
        confirmed a stop. The wire process writes it, and so does the root process when it stops the robot
        itself."""
        return self._energised.get() != 0

    @may_be_energised.setter
    def may_be_energised(self, energised: bool) -> None:
        self._energised.set(int(energised))

    @property
    def silent_until_ns(self) -> int:
        """Until when the wire process may send no heartbeat, because a library holds the interpreter's lock."""
        return self._silent.get()

    @silent_until_ns.setter
    def silent_until_ns(self, until_ns: int) -> None:
        self._silent.set(until_ns)

    @property
    def stopped_ns(self) -> int:
        """When the root was last ordered to stop the robot, for a wire process that starts later; 0 for never."""
        return self._stopped.get()

    @stopped_ns.setter
    def stopped_ns(self, time_ns: int) -> None:
        self._stopped.set(time_ns)

    @property
    def wire_pid(self) -> int:
        """Process id of the wire process that was started last; 0 if none runs. It is on the page because the root
        may end before it has sent the id to the standby."""
        return self._wire_pid.get()

    @wire_pid.setter
    def wire_pid(self, pid: int) -> None:
        self._wire_pid.set(pid)

    # -- requests that may take effect after a stop

    @property
    def is_asking(self) -> bool:
        """True while the wire process waits for a request to the robot that may take effect later."""
        return self._late.get() < 0

    def ask(self, late_ns: int) -> None:
        """Note that a request to the robot is running.

        Args:
            late_ns: If the request is cut off, it may still take effect for this long.
        """
        self._late.set(-late_ns)

    def settle(self, until_ns: int) -> None:
        """Note that no request is running. ``until_ns`` is the time until which an earlier request may take
        effect."""
        self._late.set(until_ns)

    def cut_off(self, now_ns: int) -> None:
        """Note that the wire process has ended. A request that was running is then cut off and may still take
        effect."""
        late = self._late.get()
        if late < 0:
            self._late.set(now_ns - late)

    def unsettled_s(self, now_ns: int) -> float:
        """Return for how many seconds an earlier request may still take effect; 0 if none can.

        Only an attempt that began when this was 0 can confirm a safe state.
        """
        late = self._late.get()
        return -late / NS if late < 0 else max(0.0, (late - now_ns) / NS)

    # -- the safe state that is ordered

    def order(self, safe_state: SafeState, lasts: bool = True) -> SafeState:
        """Note an order and return the safe state to which the robot must be brought.

        It is the most severe one of this order and of earlier orders that are not confirmed. Otherwise a fault
        during an e-stop, such as a lost link, would replace the e-stop's safe state by a milder one.

        Args:
            safe_state: The ordered safe state.
            lasts: True to keep the order until it is confirmed.
        """
        required = SafeState(safe_state).or_more(_BY_SEVERITY[self._ordered.get()])
        if lasts:
            self._ordered.set(required.severity)
        return required

    def confirm(self, safe_state: SafeState) -> None:
        """Note that every motor has confirmed a safe state."""
        if SafeState(safe_state).severity >= self._ordered.get():
            self.begin_anew()

    def begin_anew(self) -> None:
        """Remove the ordered safe state from the page, after its confirmation or before the robot is armed."""
        self._ordered.set(0)
