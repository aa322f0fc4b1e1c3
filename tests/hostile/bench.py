"""What the suite must know of a wire, and how a robot in memory is put together."""

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
"""What the robot took: when (s), and what it was in the words of the wire log."""


class Bench(NamedTuple):
    """One robot in memory."""

    driver: Driver
    log: Callable[[], Log]
    living: Callable[[], contextlib.AbstractAsyncContextManager[object]] = contextlib.nullcontext


class Situation(enum.StrEnum):
    """What a moving robot is in when it has to stop."""

    MOVES = "moves"  # nothing is wrong
    SILENT = "silent"  # it answers no more
    RESET = "reset"  # its connections were reset
    WIRE_ENDS = "wire ends"  # the process of the wire is gone: the root stops the robot
    ROOT_ENDS = "root ends"  # the root is gone: the process of the wire stops the robot by itself


class Rig(NamedTuple):
    """What the suite must know of a wire."""

    make: Callable[[HostilePeer], Bench]
    action: Callable[[Sequence[float]], dict[str, Any]]
    """A target near to a position, as an action."""
    floods: Mapping[str, Flood] = {}
    """Words that a peer of this wire may say without an end, by a name."""
    bombs: Mapping[str, Flood] = {}
    """Words that declare more than the protocol has. Ones follow those that are bytes."""
    wrong_ids: Mapping[str, Change] = {}
    """What puts another number, or another sender, into an answer, by what it is of."""
    understood: tuple[str, ...] = ()
    """Of ``wrong_ids``, those that leave alone what confirms a stop."""
    quick: tuple[str, ...] = ("garbled",)
    """Kinds of peers that the ordinary run meets, too."""
    first: tuple[str, ...] = ()
    """Services that get the robot to where it takes a target."""
    handshake: int = 120
    """Bytes within which a new connection is reset; of datagrams, how many of them."""
    login: str = ""
    """Why nothing can be written on a connection that is reset before it has answered."""
    streams: bool = False
    """Whether a process of its own writes setpoints until the stop has left."""
    bound_s: float = 0.05
    """From a stop to the safe frame, behind a peer that is hostile. More than the published bound
    only for what the fault itself takes: a login, a bus that must be quiet."""
    why_longer: str = ""
    latest_s: Mapping[Situation, float] = {}
    """From a stop to the first safe frame, in seconds, where a robot cannot be told at once. Each with
    its reason."""


def on_bench(driver: Driver, wire: Callable[[Clock], Wire], channel: Callable[[Clock], StopChannel]) -> Driver:
    driver.open_wire = wire  # type: ignore[method-assign]
    driver.stop_channel = lambda descriptors, clock: channel(clock)  # type: ignore[method-assign]
    return driver


def renumbered(at: int, size: int) -> Callable[[bytes], bytes]:
    """Return a change that adds one to the number of a frame."""

    def change(data: bytes) -> bytes:
        number = int.from_bytes(data[at : at + size], "big") + 1
        return data[:at] + (number % (1 << 8 * size)).to_bytes(size, "big") + data[at + size :]

    return change


def first_joint(step: float, joint: str) -> Callable[[Sequence[float]], dict[str, Any]]:
    return lambda position: {joint: position[0] + step}
