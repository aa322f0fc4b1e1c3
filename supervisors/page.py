"""The page of memory that root, wire and standby of one robot share.

    words          written by       read by         content
    heartbeats     each process     the others      the time of the last heartbeat
    owed           wire, root       standby, root   something may be energised
    silent         wire             standby         until when the wire may send no heartbeat
    ordered        each process     each process    the most severe safe state that is not confirmed yet
    stopped        root             wire            when the root was last ordered to stop the robot
    wire pid       root             standby         the wire process that was started last
    late           wire             root, standby   a request that may still take effect

These facts are in shared memory and not in messages, because a process that acts after another's
death can no longer ask it. A standby acts only if something may be energised. It brings the robot to
the safe state that was ordered from the dead process. It writes again while a request of the wire may
still take effect.
"""

from __future__ import annotations

from strands_actors.contract.safe_state import SafeState
from strands_actors.kernel.clock import NS
from strands_actors.kernel.health.heartbeat import Word, private_page

ROOT, WIRE, STANDBY = range(3)
"""Indices of the heartbeats."""
_OWED, _SILENT, _ORDERED, _STOPPED, _WIRE_PID, _LATE = 3, 4, 5, 6, 7, 8
_BY_SEVERITY = tuple(SafeState)


class Owed:
    """The words of the page that say which orders and requests of a robot are still open.

    Args:
        words: The shared page; None for a private one.
    """

    def __init__(self, words: memoryview | None = None) -> None:
        page = private_page() if words is None else words
        self._owed = Word(page, _OWED)
        self._silent = Word(page, _SILENT)
        self._ordered = Word(page, _ORDERED)  # a severity; 0 without an order, or for the mildest state
        self._stopped = Word(page, _STOPPED)
        self._wire_pid = Word(page, _WIRE_PID)
        # Negative: a request is running. If it is cut off, it may take effect for that many nanoseconds more.
        # Positive: a request was cut off, and may take effect until this time. 0: neither.
        self._late = Word(page, _LATE)

    @property
    def safe_state(self) -> bool:
        """True if something may be energised: from before an arming until every motor has confirmed a
        stop. Written by the wire, and by the root when it stops the robot instead."""
        return self._owed.get() != 0

    @safe_state.setter
    def safe_state(self, owed: bool) -> None:
        self._owed.set(int(owed))

    @property
    def silent_until_ns(self) -> int:
        """The wire may send no heartbeat until this time, because an SDK keeps the interpreter's lock."""
        return self._silent.get()

    @silent_until_ns.setter
    def silent_until_ns(self, until_ns: int) -> None:
        self._silent.set(until_ns)

    @property
    def stopped_ns(self) -> int:
        """When the root was last ordered to stop the robot, for a wire that starts later; 0 for never."""
        return self._stopped.get()

    @stopped_ns.setter
    def stopped_ns(self, at_ns: int) -> None:
        self._stopped.set(at_ns)

    @property
    def wire_pid(self) -> int:
        """Process id of the wire that was started last; 0 if no wire runs. The root writes it here, since it
        may end before it has sent it to the standby."""
        return self._wire_pid.get()

    @wire_pid.setter
    def wire_pid(self, pid: int) -> None:
        self._wire_pid.set(pid)

    # -- requests that may take effect after a stop

    @property
    def is_asking(self) -> bool:
        """True while a request of the wire is running that may take effect later."""
        return self._late.get() < 0

    def ask(self, late_ns: int) -> None:
        """Note that a request is running.

        Args:
            late_ns: Longest time after a cut-off in which it may still take effect.
        """
        self._late.set(-late_ns)

    def settle_at(self, until_ns: int) -> None:
        """Note that no request is running, and until when an earlier one may take effect."""
        self._late.set(until_ns)

    def cut_off(self, now_ns: int) -> None:
        """Note that the wire process has ended, which cuts off a running request."""
        late = self._late.get()
        if late < 0:
            self._late.set(now_ns - late)

    def unsettled_s(self, now_ns: int) -> float:
        """Return for how many seconds a request may still take effect.

        A safe state is confirmed only by an attempt that began when this was 0.
        """
        late = self._late.get()
        return -late / NS if late < 0 else max(0.0, (late - now_ns) / NS)

    # -- the ordered safe state

    def order(self, safe_state: SafeState, lasts: bool = True) -> SafeState:
        """Note an order and return the safe state to bring the robot to.

        It is the more severe one of this order and of earlier orders that are not confirmed. Otherwise
        a fault during an e-stop (a lost link, a frozen wire) would end in its own, milder state.

        Args:
            safe_state: The ordered safe state.
            lasts: True if the order counts until it is confirmed.
        """
        wanted = SafeState(safe_state).or_more(_BY_SEVERITY[self._ordered.get()])
        if lasts:
            self._ordered.set(wanted.severity)
        return wanted

    def confirm(self, safe_state: SafeState) -> None:
        """Note that every motor has confirmed a safe state."""
        if SafeState(safe_state).severity >= self._ordered.get():
            self.begin_anew()

    def begin_anew(self) -> None:
        """Forget the orders, after a confirmation or before an arming."""
        self._ordered.set(0)
