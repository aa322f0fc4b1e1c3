"""The mailbox: one reader, many senders, three lanes.

Theory. A stop must not wait behind other messages, and a slow reader must not act on old setpoints.

* ``put`` never waits, so messages of one sender and one lane arrive in the order in which they were sent.
* The reader looks for ``urgent`` messages before *each* other message. So a stop waits for at most the one
  handler that runs (12 us measured behind 10 000 queued messages, against 242 ms in a plain queue).
* ``command`` messages wait in a bounded queue. A full queue refuses further ones.
* ``latest`` messages have one place (``Slot``) per sender and type, and a newer message replaces the older one
  there. So a slow reader sees the newest setpoint and never a backlog. The place keeps its position in the
  queue of commands.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Protocol

import trio

from . import refusals
from .messages import Message

CAPACITY = 1024


class ReplyTo(Protocol):
    """The receiver of an answer. It ignores a second answer, and an answer that comes too late."""

    def send(self, answer: Message | None) -> None: ...


Entry = tuple[Message, ReplyTo | None]
Item = Message | Entry
"""A queued message, with the receiver of its answer if there is one."""


class Slot:
    """The place for the newest message of one sender and one type, in the lane (queue) ``latest``. An empty place
    is kept for the next message.
    """

    __slots__ = ("entry",)

    def __init__(self) -> None:
        self.entry: Entry | None = None

    def take(self) -> Entry:
        entry, self.entry = self.entry, None
        assert entry is not None
        return entry


_SLOTS = 64
"""If there are so many places, empty places are dropped. Senders change, so their places would add up."""


SUPERSEDED = refusals.superseded()


class Mailbox:
    """The waiting messages of one actor, in three lanes (queues), with a single reader.

    Not thread-safe: messages of other threads and processes come in through a mesh.

    Args:
        capacity: The greatest number of messages in the urgent lane, and in the queue of the other two lanes.
        offer: Called when a message comes while the reader waits. It returns True if the message will be read
            without waking the reader, or if the reader will be woken later.
    """

    __slots__ = ("_offer", "_slots", "_waiter", "capacity", "conflated", "idle", "on_urgent", "queue", "urgent")

    def __init__(self, capacity: int = CAPACITY, offer: Callable[[], bool] | None = None) -> None:
        self.capacity = capacity
        self._offer = offer
        self.idle = False
        """True while the reader waits and has not been notified of a message yet."""
        self.conflated = 0
        self.urgent: deque[Item] = deque()
        self.queue: deque[Item | Slot] = deque()
        self._slots: dict[tuple[str, type], Slot] = {}
        self._waiter: trio.lowlevel.Task | None = None
        self.on_urgent: Callable[[], object] | None = None
        """Called when an urgent message comes while a handler runs. ``Context.until_urgent`` sets it."""

    def __len__(self) -> int:
        return len(self.urgent) + len(self.queue)

    @property
    def urgent_waiting(self) -> bool:
        """True if a stop or another urgent message waits. A long handler checks this between its steps, to let
        the urgent message through.
        """
        return bool(self.urgent)

    def put(self, message: Message, reply: ReplyTo | None, sender: str) -> bool:
        """Queue a message. Return False, and queue nothing, if its lane (one of three queues) is full."""
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
        """Notify the waiting reader that a message is there."""
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
        """Accept an offer of messages. Return True if the reader still waits, so that the caller may read in
        its place.
        """
        self.idle = self._waiter is not None
        return self.idle

    def wake(self) -> None:
        """Wake the reader, even if there is no message."""
        self.idle = False
        waiter = self._waiter
        if waiter is not None:
            self._waiter = None
            trio.lowlevel.reschedule(waiter)

    def first(self) -> Entry | None:
        """Return the entry that ``pop`` would return, and leave it in the mailbox."""
        if self.urgent:
            return _entry(self.urgent[0])
        if not self.queue:
            return None
        item = self.queue[0]
        return item.entry if isinstance(item, Slot) else _entry(item)

    def pop(self) -> Entry | None:
        """Remove and return the next entry, urgent ones first. Return None if there is none."""
        if self.urgent:
            return _entry(self.urgent.popleft())
        if not self.queue:
            return None
        item = self.queue.popleft()
        return item.take() if isinstance(item, Slot) else _entry(item)

    async def wait(self) -> None:
        """Return when a message is there, or after ``wake``. There may be one reader only."""
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
