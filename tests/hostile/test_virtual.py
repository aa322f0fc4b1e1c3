"""Test that a stop is written whatever the robot sends, on every wire, in virtual time.

Each cell is one robot with its own gate, watchdog, transport, guardian and stop channel. It meets one kind of
hostile peer (SAF-022, SAF-025).
"""

from __future__ import annotations

import contextlib
import itertools
import tracemalloc
from collections.abc import AsyncIterator, Callable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import pytest
import trio
import trio.testing

from strands_actors.contract.driver import Reason
from strands_actors.kernel.messages import Refused
from strands_actors.kernel.node import AskTimeout, Unreachable
from strands_actors.supervisors.gate.failsafe import Mode
from strands_actors.supervisors.gate.messages import (
    Beat,
    Lease,
    Perform,
    Performed,
    Resume,
    Resumed,
    Stop,
    StopReport,
)
from strands_actors.testing import InlineTree, open_inline_tree
from tests.tree.writer import Writer

from .bench import Bench, Rig
from .peer import Change, Flood, HostilePeer, Steps
from .rigs import RIGS

MOST_MEMORY = 32 << 20
"""Bytes by which a peer may make a process grow."""
BEFORE_S = (0.3, 0.02, 0.1)
"""Seconds from the beginning of the fault to the stop. After the first value most wires have given up their
link. Only the long run uses the other values."""
TAKEN_S = 0.001
"""Time for a robot to read the host's bytes."""
AGAIN_S = 2.0
HEALED_S = 20.0
"""Time within which a robot that is honest again is connected and confirmed safe."""


class Fault(NamedTuple):
    """The hostile peer of one cell."""

    robot: str
    kind: str
    detail: str = ""

    def __str__(self) -> str:
        return "-".join(filter(None, self)).replace(" ", "_")

    @property
    def rig(self) -> Rig:
        return RIGS[self.robot]

    @property
    def may_confirm(self) -> bool:
        """True if the robot's own output gets through, so that a stop can be confirmed."""
        return self.kind == "flood" or (self.kind == "wrong ids" and self.detail in self.rig.understood)

    def begin(self, peer: HostilePeer) -> None:
        match self.kind:
            case "flood":
                peer.begin("flood", self.rig.floods[self.detail])
            case "bomb":
                peer.begin("changed", change=exploding(self.rig.bombs[self.detail]))
            case "wrong ids":
                peer.begin("changed", change=self.rig.wrong_ids[self.detail])
            case kind:
                peer.begin(kind, deaf=kind == "garbled both ways")


def exploding(bomb: Flood) -> Change:
    """Return a change that puts a bomb in the place of each answer."""
    numbers = itertools.count()
    return lambda data: bomb + bytes((1,)) * (1 << 16) if isinstance(bomb, bytes) else bomb(next(numbers))


GENERAL = ("garbled", "garbled both ways", "half a frame", "one byte a second", "older answers")


def faults() -> list[Fault]:
    found = [Fault(robot, kind) for robot in RIGS for kind in GENERAL]
    for robot, rig in RIGS.items():
        found += [Fault(robot, "flood", name) for name in rig.floods]
        found += [Fault(robot, "bomb", name) for name in rig.bombs]
        found += [Fault(robot, "wrong ids", name) for name in rig.wrong_ids]
    return found


class Asked(NamedTuple):
    """The time of a stop's request, and the length of the wire's log at that time.

    The length separates entries of the same instant: those written before the request are not after it.
    """

    t_s: float
    entries: int


class Trial(NamedTuple):
    """A moving robot with the peer at its other end."""

    tree: InlineTree
    peer: HostilePeer
    bench: Bench
    rig: Rig
    writer: Writer

    def first(self, kind: str, entries: int = 0) -> float | None:
        return next((t_s for t_s, what in self.bench.log()[entries:] if what == kind), None)

    def ask(self) -> Asked:
        return Asked(trio.current_time(), len(self.bench.log()))

    def behind(self, kind: str) -> int:
        """Return the index after the last log entry of this kind."""
        return max((at + 1 for at, (_, what) in enumerate(self.bench.log()) if what == kind), default=0)

    async def beat(self) -> None:
        """Send heartbeats, as a caller's process does."""
        while True:
            self.writer.ref.tell(Beat(self.writer.lease.id))
            await trio.sleep(0.2)

    async def move(self) -> None:
        """Send small moves as long as they are accepted."""
        while True:
            with contextlib.suppress(Unreachable, AskTimeout):  # its wire group is being replaced
                seen = (await self.tree.status()).observation
                if seen is not None:
                    await self.writer.send(**self.rig.action(seen.position))
            await trio.sleep(0.05)


def run(test: Callable[[HostilePeer], object]) -> None:
    steps = Steps()

    async def main() -> None:
        await test(HostilePeer(steps))  # type: ignore[misc]

    trio.run(main, clock=trio.testing.MockClock(autojump_threshold=0), instruments=[steps])


@contextlib.asynccontextmanager
async def moving(peer: HostilePeer, rig: Rig) -> AsyncIterator[Trial]:
    bench = rig.make(peer)
    async with bench.living(), open_inline_tree(driver=bench.driver) as tree:
        writer = Writer(tree)
        trial = Trial(tree, peer, bench, rig, writer)
        async with trio.open_nursery() as nursery:
            nursery.start_soon(trial.beat)
            await ready(trial)
            nursery.start_soon(trial.move)
            with trio.fail_after(5):
                while trial.first("setpoint") is None:  # noqa: ASYNC110  # the tree's doing
                    await trio.sleep(0.01)
            yield trial
            nursery.cancel_scope.cancel()


async def ready(trial: Trial) -> None:
    """Arm the robot, take the lease, and run the services after which it accepts targets."""
    tree, rig, writer = trial.tree, trial.rig, trial.writer
    resumed = await tree.gate.ask(Resume("test"), 20.0)
    assert isinstance(resumed, Resumed), resumed
    assert isinstance(await writer.acquire(), Lease)
    for service in rig.first:
        request = Perform(writer.lease.id, writer.lease.epoch, service, {})
        answer = await writer.ref.ask(request, 20.0)
        assert isinstance(answer, Performed), answer


class Answer(NamedTuple):
    """The result of a stop.

    Attributes:
        report: The report; None if no answer came in time.
        had_begun: The gate, or the root after the end of the wire process, was already stopping the robot.
    """

    report: StopReport | None
    had_begun: bool


async def stopped(trial: Trial, reason: Reason) -> Answer:
    """Request a stop from the gate, or from its successor."""
    had_begun, report = False, None
    with trio.move_on_after(trial.tree.driver.timing.safe_s + 1.0):
        while True:
            try:
                had_begun = had_begun or (await trial.tree.status()).mode == Mode.STOPPING
                answer = await trial.tree.gate.ask(Stop(reason), 60.0)
            except Unreachable:
                had_begun = True
                await trio.sleep(0.01)
                continue
            assert not isinstance(answer, Refused), answer
            report = answer if isinstance(answer, StopReport) else None
            break
    await trio.sleep(TAKEN_S)
    return Answer(report, had_begun)


async def heal(trial: Trial) -> None:
    """Request a stop repeatedly, as a person would, until every motor has confirmed it. A stop cuts an attempt
    to connect short."""
    with trio.fail_after(HEALED_S):
        while True:
            await trio.sleep(AGAIN_S)
            with contextlib.suppress(Unreachable, AskTimeout):
                status = await trial.tree.status()
                if status.connected and status.mode == "disarmed":
                    return
                await stopped(trial, Reason.STOP)


def is_safe(trial: Trial, fault: Fault, asked: Asked, answer: Answer) -> None:
    """Assert that the wire's log shows a stop. If the stop had begun before the request, its frame may be there
    already. Then no setpoint may follow it."""
    log = trial.bench.log()
    since = trial.behind("setpoint") if answer.had_begun else asked.entries
    if trial.peer.deaf:
        assert trial.peer.writes, "nothing was written"
        after = [what for _, what in log[asked.entries :]]
    else:
        safe = next((at for at, (_, what) in enumerate(log) if what == "safe" and at >= since), None)
        assert safe is not None, "no safe frame"
        took_s = log[safe][0] - asked.t_s
        assert took_s <= fault.rig.bound_s, f"safe after {took_s * 1e3:.0f} ms"
        after = [
            what for at, (_, what) in enumerate(log) if at >= asked.entries and (at > safe or not fault.rig.streams)
        ]
    assert "setpoint" not in after, "a setpoint after the stop"
    if answer.report is not None and answer.report.confirmed:
        assert fault.may_confirm, "confirmed by words that cannot be understood"


FAULTS = faults()


def _long(faults: Sequence[Fault], quick: Callable[[Fault], bool]) -> list[Any]:
    return [fault if quick(fault) else pytest.param(fault, marks=pytest.mark.long) for fault in faults]


def is_quick(fault: Fault) -> bool:
    """True for cells of the ordinary run: the kinds in ``Rig.quick``, and of floods, bombs and ids the first."""
    rig = fault.rig
    named: Mapping[str, Iterable[str]] = {"flood": rig.floods, "bomb": rig.bombs, "wrong ids": rig.wrong_ids}
    first = next(iter(named.get(fault.kind, ())), "")
    return fault.kind in fault.rig.quick and fault.detail == first


def is_quick_end(fault: Fault) -> bool:
    return fault.kind == "garbled" and fault.robot in ("xarm7", "so101", "kinova_gen3")


@pytest.mark.parametrize(
    "before_s", [BEFORE_S[0], *(pytest.param(before_s, marks=pytest.mark.long) for before_s in BEFORE_S[1:])]
)
@pytest.mark.parametrize("fault", _long(FAULTS, is_quick), ids=str)
def test_saf_022_025_a_hostile_peer_keeps_no_stop_back(fault: Fault, before_s: float) -> None:
    async def test(peer: HostilePeer) -> None:
        async with moving(peer, fault.rig) as trial:
            if fault.kind == "bomb":  # a bomb makes everything else slow
                tracemalloc.start()
            try:
                fault.begin(peer)
                await trio.sleep(before_s)
                request = trial.ask()
                answer = await stopped(trial, Reason.STOP)
                _, most = tracemalloc.get_traced_memory()  # 0 if nothing was traced
            finally:
                tracemalloc.stop()
            assert most <= MOST_MEMORY, f"it grew by {most >> 20} MB"
            is_safe(trial, fault, request, answer)
            written = len(trial.bench.log())
            peer.end()
            await heal(trial)
            assert "setpoint" not in [what for _, what in trial.bench.log()[written:]], "a setpoint after the stop"

    run(test)


@pytest.mark.parametrize("fault", _long(FAULTS, is_quick_end), ids=str)
def test_saf_022_025_the_caller_ends_behind_a_hostile_peer(fault: Fault) -> None:
    """The root reports the end of the caller to the gate, as when the caller's process is gone."""

    async def test(peer: HostilePeer) -> None:
        async with moving(peer, fault.rig) as trial:
            fault.begin(peer)
            await trio.sleep(BEFORE_S[0])
            request = trial.ask()
            is_safe(trial, fault, request, await stopped(trial, Reason.CALLER))

    run(test)


RESETS = [robot for robot, rig in RIGS.items() if not rig.login]


@pytest.mark.parametrize("robot", RESETS)
@pytest.mark.parametrize(
    "every", [False, pytest.param(True, marks=pytest.mark.long)], ids=["some bytes", "each byte"]
)
def test_saf_022_a_connection_that_is_reset_at_a_byte_of_its_handshake(robot: str, every: bool) -> None:
    """The link is lost while the robot moves, and each new one is reset after so many bytes."""

    async def test(peer: HostilePeer) -> None:
        fault = Fault(robot, "flood")  # the robot's own bytes get through
        streams, datagrams = (0, 1, 7, 20, 60), (7,)
        some = streams if fault.rig.handshake > max(streams) else datagrams
        numbers: Sequence[int] = range(fault.rig.handshake) if every else some
        async with moving(peer, fault.rig) as trial:
            for number in numbers:
                peer.reset_after = number
                peer.reset()
                await trio.sleep(0.05)
                request = trial.ask()
                is_safe(trial, fault, request, await stopped(trial, Reason.STOP))

    run(test)
