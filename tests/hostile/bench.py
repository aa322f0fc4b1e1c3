"""Define the data that the suite needs of a wire, and how a robot in memory is assembled."""

from __future__ import annotations

import contextlib
import enum
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

from strands_actors.contract.driver import Driver
from strands_actors.contract.wire import StopChannel, Wire
from strands_actors.kernel.clock import Clock

from .peer import Change, Flood, HostilePeer

Log = list[tuple[float, str]]
"""Messages that the robot received: time (s) and kind, in the words of the wire log."""


class Bench(NamedTuple):
    """One robot in memory."""

    driver: Driver
    log: Callable[[], Log]
    living: Callable[[], contextlib.AbstractAsyncContextManager[object]] = contextlib.nullcontext
    robot: Any = None
    """The simulated robot behind the wire, where a test looks at it."""


class Situation(enum.StrEnum):
    """The fault from which a moving robot has to stop."""

    MOVES = "moves"  # nothing is wrong
    SILENT = "silent"  # it no longer answers
    RESET = "reset"  # its connections were reset
    WIRE_ENDS = "wire ends"  # the wire process is gone, and the root stops the robot
    ROOT_ENDS = "root ends"  # the root is gone, and the wire process stops the robot by itself


class Rig(NamedTuple):
    """The data that the suite needs of a wire."""

    make: Callable[[HostilePeer], Bench]
    action: Callable[[Sequence[float]], dict[str, Any]]
    """Return an action that moves the robot near to a position."""
    floods: Mapping[str, Flood] = {}
    """Named messages that a peer of this wire may repeat without end."""
    bombs: Mapping[str, Flood] = {}
    """Named messages that declare a larger size than the protocol allows. Bytes are followed by ones."""
    wrong_ids: Mapping[str, Change] = {}
    """Named changes that put a wrong number, or a wrong sender, into an answer."""
    understood: tuple[str, ...] = ()
    """The ``wrong_ids`` that do not touch the messages by which a stop is confirmed."""
    quick: tuple[str, ...] = ("garbled",)
    """Kinds of peers that the ordinary run includes."""
    first: tuple[str, ...] = ()
    """Services after which the robot accepts a target."""
    handshake: int = 120
    """A new connection is reset within this number of bytes (of datagrams: this number of datagrams)."""
    login: str = ""
    """Why nothing can be written on a connection that is reset before its answer."""
    streams: bool = False
    """True if a separate process writes setpoints until the stop has left."""
    bound_s: float = 0.05
    """Longest time from a stop to the safe frame with a hostile peer. It exceeds the published bound only by
    the time that the fault itself takes: a login, a bus that must be quiet."""
    why_longer: str = ""
    latest_s: Mapping[Situation, float] = {}
    """Seconds from a stop to the first safe frame, where a robot cannot be stopped at once. Each entry has its
    reason."""


def on_bench(driver: Driver, wire: Callable[[Clock], Wire], channel: Callable[[Clock], StopChannel]) -> Driver:
    driver.open_wire = wire  # type: ignore[method-assign]
    driver.stop_channel = lambda descriptors, clock: channel(clock)  # type: ignore[method-assign]
    return driver


def renumbered(at: int, size: int) -> Callable[[bytes], bytes]:
    """Return a change that adds one to the number in a frame."""

    def change(data: bytes) -> bytes:
        number = int.from_bytes(data[at : at + size], "big") + 1
        return data[:at] + (number % (1 << 8 * size)).to_bytes(size, "big") + data[at + size :]

    return change


def first_joint(step: float, joint: str) -> Callable[[Sequence[float]], dict[str, Any]]:
    return lambda position: {joint: position[0] + step}
