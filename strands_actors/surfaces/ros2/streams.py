"""Decide which messages of the graph may command a robot. Pure: no clock, no I/O.

ROS has no lease: every program may publish on a topic at any time. So the messages are seen as streams, and one
stream at a time commands the robot.

Invariants:

* Only the publisher that began a stream continues it. Another one is refused until the stream has paused.
* After the robot has refused a stream (it was stopped, it holds, another program has the lease), no message of
  this stream is sent any more. A publisher that simply goes on would otherwise move the robot at the moment of a
  ``resume``. Only a pause ends the refusal.
* A message that was delayed in the network is worth less: its delay is taken off its lifetime.
"""

from __future__ import annotations

from typing import NamedTuple

from strands_actors.kernel.clock import NS
from strands_actors.kernel.messages import Refused

from . import refusals

PAUSE_S = 1.0
"""A stream ends when no message came for so long. A lease on the mesh ends after the same time."""
DRIFT = 1e-4
"""The largest difference in speed of two clocks that is expected, as a fraction."""


class Sender(NamedTuple):
    """The sender of a message.

    Attributes:
        gid: The identifier of its publisher.
        name: The name to show to people.
    """

    gid: bytes
    name: str


class Delay:
    """Estimates how much longer a message took than the fastest one of its stream.

    The clocks of two computers differ by an unknown amount. The smallest difference between arrival and sending
    belongs to the fastest message, and every other message took as much longer as its difference is larger. The
    smallest difference may grow by ``DRIFT``, so that clocks of different speed are not taken for a delay.
    """

    def __init__(self) -> None:
        self._least_ns: float | None = None
        self._arrived_ns = 0

    def seconds(self, sent_ns: int, arrived_ns: int) -> float:
        """Return the delay of a message, in seconds.

        Args:
            sent_ns: The time of sending on the sender's clock, in nanoseconds.
            arrived_ns: The time of arrival on this host's clock, in nanoseconds.
        """
        difference_ns = float(arrived_ns - sent_ns)
        if self._least_ns is None:
            least_ns = difference_ns
        else:
            drift_ns = DRIFT * max(arrived_ns - self._arrived_ns, 0)
            least_ns = min(difference_ns, self._least_ns + drift_ns)
        self._least_ns, self._arrived_ns = least_ns, arrived_ns
        return (difference_ns - least_ns) / NS


class Streams:
    """Admits the messages for one robot.

    Args:
        lifetime_s: How long a command is valid, in seconds.
    """

    def __init__(self, lifetime_s: float) -> None:
        self.lifetime_s = lifetime_s
        self.sender: Sender | None = None
        """The sender of the present stream; None if no stream commands the robot."""
        self._last_ns = 0
        self._delay = Delay()
        self._ended = ""

    def admit(self, topic: str, sender: Sender, sent_ns: int, arrived_ns: int) -> float | Refused:
        """Return how many seconds from its arrival a message is valid, or the refusal.

        Args:
            topic: The name of the topic, for refusals.
            sender: The sender.
            sent_ns: The time of sending on the sender's wall clock, in nanoseconds.
            arrived_ns: The time of arrival on this host's clock, in nanoseconds.
        """
        if self.is_over(arrived_ns):
            self.forget()
        if self.sender is None:
            self.sender, self._delay = sender, Delay()
        elif sender.gid != self.sender.gid:
            return refusals.second_writer(topic, sender.name, self.sender.name, PAUSE_S)
        self._last_ns = arrived_ns
        late_s = self._delay.seconds(sent_ns, arrived_ns)
        if self._ended:
            return refusals.stream_ended(topic, self._ended, PAUSE_S)
        if late_s >= self.lifetime_s:
            return refusals.late_message(topic, late_s, self.lifetime_s)
        return self.lifetime_s - late_s

    def end(self, because: str) -> None:
        """Refuse the rest of the present stream. ``because`` is the robot's refusal."""
        if self.sender is not None:
            self._ended = because

    def is_over(self, now_ns: int) -> bool:
        """Return True if no message came for ``PAUSE_S``."""
        return self.sender is not None and now_ns - self._last_ns >= PAUSE_S * NS

    def forget(self) -> None:
        """Forget the present stream. The next message begins another one."""
        self.sender, self._ended = None, ""
