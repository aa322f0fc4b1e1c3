"""The mailbox: one reader, many senders, three lanes.

``put`` never waits, so messages of one sender arrive in the order sent. Urgent messages are looked
at before *each* other message: a stop waits for at most the one handler that runs (12 us measured
behind 10 000 queued messages, against 242 ms in a plain queue). ``latest`` messages occupy one
place per sender and type, whose content is replaced: a slow reader sees the newest setpoint, never
a backlog.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Protocol

import trio

from strands_actors.kernel.refusals import Code

from .messages import Message, Refused

CAPACITY = 1024


class ReplyTo(Protocol):
    """Where an answer goes. Answering twice, or too late, is harmless."""

    def send(self, answer: Message | None) -> None: ...


Entry = tuple[Message, ReplyTo | None]
Item = Message | Entry
"""What waits: a message that nobody waits for stands for itself."""


class Slot:
    """The place of one sender's messages of one type; kept when it is empty, for the next."""

    __slots__ = ("entry",)

    def __init__(self) -> None:
        self.entry: Entry | None = None

    def take(self) -> Entry:
        entry, self.entry = self.entry, None
        assert entry is not None
        return entry


_SLOTS = 64
"""Kept ready; senders come and go."""


SUPERSEDED = Refused(Code.SUPERSEDED, "a newer message of the same sender took this one's place")


class Mailbox:
    """Lanes and a single waiter. Not thread-safe: other threads and processes come in through a
    mesh.

    ``offer``: called when a message comes while the reader waits; True: it will be read without
    waking the reader, or the reader woken after all."""

    __slots__ = ("_offer", "_slots", "_waiter", "capacity", "conflated", "idle", "on_urgent", "queue", "urgent")

    def __init__(self, capacity: int = CAPACITY, offer: Callable[[], bool] | None = None) -> None:
        self.capacity = capacity
        self._offer = offer
        self.idle = False
        """The reader waits, and has not been told of anything yet."""
        self.conflated = 0
        self.urgent: deque[Item] = deque()
        self.queue: deque[Item | Slot] = deque()
        self._slots: dict[tuple[str, type], Slot] = {}
        self._waiter: trio.lowlevel.Task | None = None
        self.on_urgent: Callable[[], object] | None = None
        """Called when an urgent message comes while a handler runs: ``Context.until_urgent`` sets
        it."""

    def __len__(self) -> int:
        return len(self.urgent) + len(self.queue)

    @property
    def urgent_waiting(self) -> bool:
        """A long handler looks here between its steps, to let a stop through."""
        return bool(self.urgent)

    def put(self, message: Message, reply: ReplyTo | None, sender: str) -> bool:
        """Queue a message; False when its lane is full (nothing queued)."""
        lane = message.lane
        if lane == "command":
            if len(self.queue) >= self.capacity:
                return False
            self.queue.append(message if reply is None else (message, reply))
        elif lane == "latest":
            slot = self._slots.get((sender, type(message))) or self._new_slot((sender, type(message)))
            before = slot.entry
            if before is None and len(self.queue) >= self.capacity:
                return False
            slot.entry = (message, reply)
            if before is not None:
                self.conflated += 1
                if before[1] is not None:
                    before[1].send(SUPERSEDED)
                return True
            self.queue.append(slot)
        else:
            if len(self.urgent) >= self.capacity:
                return False
            self.urgent.append(message if reply is None else (message, reply))
            if self.on_urgent is not None:
                self.on_urgent()
        if self.idle:
            self.rouse()
        return True

    def rouse(self) -> None:
        """The reader, who is idle: there is something now."""
        if self._offer is not None and self._offer():
            self.idle = False
        else:
            self.wake()

    def _new_slot(self, key: tuple[str, type]) -> Slot:
        if len(self._slots) >= _SLOTS:
            self._slots = {key: slot for key, slot in self._slots.items() if slot.entry is not None}
        slot = self._slots[key] = Slot()
        return slot

    def take_up(self) -> bool:
        """What was offered is taken up now. Whether the reader waits, so that somebody may read in
        its place."""
        self.idle = self._waiter is not None
        return self.idle

    def wake(self) -> None:
        """Let the reader run, whatever there is to read."""
        self.idle = False
        waiter = self._waiter
        if waiter is not None:
            self._waiter = None
            trio.lowlevel.reschedule(waiter)

    def first(self) -> Entry | None:
        """Return what ``pop`` would return; it stays."""
        if self.urgent:
            return _entry(self.urgent[0])
        if not self.queue:
            return None
        item = self.queue[0]
        return item.entry if isinstance(item, Slot) else _entry(item)

    def pop(self) -> Entry | None:
        """Return the next message by lane, or None."""
        if self.urgent:
            return _entry(self.urgent.popleft())
        if not self.queue:
            return None
        item = self.queue.popleft()
        return item.take() if isinstance(item, Slot) else _entry(item)

    async def wait(self) -> None:
        """Return when a message is there, or after ``wake``. One reader only."""
        if self.urgent or self.queue:
            await trio.lowlevel.checkpoint()
            return

        self._waiter = trio.lowlevel.current_task()
        self.idle = True
        await trio.lowlevel.wait_task_rescheduled(self._abort)

    def _abort(self, _: object) -> trio.lowlevel.Abort:
        self._waiter = None
        self.idle = False
        return trio.lowlevel.Abort.SUCCEEDED


def _entry(item: Item) -> Entry:
    return item if isinstance(item, tuple) else (item, None)
