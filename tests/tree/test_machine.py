"""Events in any order, in virtual time. The frames on the wire decide."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass, field

import pytest
import trio
from hypothesis import given, settings
from hypothesis import strategies as st

from strands_actors.contract.driver import Reason
from strands_actors.kernel.messages import Refused
from strands_actors.kernel.node import AskTimeout, Unreachable
from strands_actors.supervisors.gate.messages import (
    LEASE_TTL_S,
    Accepted,
    Acquire,
    Beat,
    Lease,
    Resume,
    Stop,
    StopReport,
)
from strands_actors.testing import InlineTree, open_inline_tree, run_virtual

from .writer import Writer

MS = 1_000_000
EVENTS = (
    "setpoint", "setpoint", "setpoint", "latched", "expired", "second writer", "stop", "estop", "resume",
    "resume", "crash", "link loss", "replug", "beat", "wait", "wait long",
)  # fmt: skip


@dataclass
class Sent:
    at_ns: int
    deadline_ns: int
    latched: bool


@dataclass
class History:
    """The actions of the test, for comparison with the frames on the wire. Each setpoint has its own value."""

    sent: dict[float, Sent] = field(default_factory=dict)
    locked: list[tuple[int, int]] = field(default_factory=list)
    crashes: list[int] = field(default_factory=list)
    resumes: list[int] = field(default_factory=list)
    locked_since: int = 0


class Player:
    def __init__(self, tree: InlineTree) -> None:
        self.tree = tree
        self.first = Writer(tree, "alice")
        self.second = Writer(tree, "bob")
        self.history = History()
        self.value = 0.0
        self.alice_ns = 0  # time of alice's last action that keeps her lease

    def now(self) -> int:
        return self.tree.node.clock.now_ns()

    async def play(self, event: str) -> None:
        # The actors are unreachable while a crash is handled, and the answer says so. The frames on the
        # wire are checked in any case.
        with contextlib.suppress(AskTimeout, Unreachable):
            await getattr(self, "_" + event.replace(" ", "_"))()
        await trio.sleep(0.003)

    async def _send(self, writer: Writer, ttl_s: float, latched: bool) -> object:
        self.value = (self.value + 0.25) % 100.0
        setpoint = writer.setpoint(ttl_s, latched, a=self.value)
        self.history.sent[self.value] = Sent(self.now(), setpoint.deadline_ns, latched)
        answer = await writer.ref.ask(setpoint, 1.0)
        if writer is self.first and isinstance(answer, Accepted):
            self.alice_ns = self.now()
        return answer

    async def _setpoint(self) -> None:
        if isinstance(await self._send(self.first, 0.1, False), Refused):
            await self._acquire()

    async def _latched(self) -> None:
        await self._send(self.first, 0.1, True)

    async def _expired(self) -> None:
        assert isinstance(await self._send(self.first, -0.001, False), Refused)

    async def _second_writer(self) -> None:
        """SAF-009: bob gets the lease only after alice's has expired, and writes nothing without it."""
        holder = (await self.tree.status()).holder
        silent_ns = self.now() - self.alice_ns
        answer = await self.second.ref.ask(Acquire("bob", again=self.second.lease.id), 1.0)
        if holder == "alice":
            assert isinstance(answer, Lease) == (silent_ns >= LEASE_TTL_S * 1e9)
        if isinstance(answer, Lease):
            self.second.lease = answer
        else:
            assert isinstance(answer, Refused) and "alice" in answer.reason
            self.second.lease = Lease(1, self.first.lease.epoch)
        sent = await self._send(self.second, 0.1, False)
        assert isinstance(answer, Lease) or isinstance(sent, Refused)

    async def _stop(self) -> None:
        status = await self.tree.status()
        at_ns = self.now()
        report = await self.tree.gate.ask(Stop(Reason.STOP), 2.0)
        assert isinstance(report, StopReport)
        if status.connected and self.tree.hardware.plugged:
            # SAF-006
            assert report.confirmed
            assert self.tree.hardware.of("safe", at_ns)[0].t_ns - at_ns < 30 * MS

    async def _estop(self) -> None:
        self.history.locked_since = self.history.locked_since or self.now()
        await self.tree.gate.ask(Stop(Reason.ESTOP, "op", lock=True), 2.0)

    async def _resume(self) -> None:
        self.history.resumes.append(self.now())
        answer = await self.tree.gate.ask(Resume(), 2.0)
        if not isinstance(answer, Refused) and self.history.locked_since:
            self.history.locked.append((self.history.locked_since, self.history.resumes[-1]))
            self.history.locked_since = 0
        await self._acquire()

    async def _acquire(self) -> None:
        if isinstance(await self.first.acquire(), Lease):
            self.alice_ns = self.now()

    async def _crash(self) -> None:
        self.history.crashes.append(self.now())
        self.tree.wire._scope.cancel()
        await trio.sleep(0.05)

    async def _link_loss(self) -> None:
        self.tree.hardware.plugged = False
        await trio.sleep(0.03)

    async def _replug(self) -> None:
        self.tree.hardware.plugged = True
        await trio.sleep(0.3)

    async def _beat(self) -> None:
        if (await self.tree.status()).holder == "alice":
            self.first.ref.tell(Beat(self.first.lease.id))
            self.alice_ns = self.now()

    async def _wait(self) -> None:
        await trio.sleep(0.06)

    async def _wait_long(self) -> None:
        await trio.sleep(1.3)


def judge(player: Player) -> None:
    history, hardware = player.history, player.tree.hardware
    written = hardware.written
    safes = [entry for entry in written if entry.kind == "safe"]
    for entry in written:
        if entry.kind != "setpoint":
            continue
        sent = history.sent[entry.values[0]]
        # SAF-001
        if not sent.latched:
            assert entry.t_ns < sent.deadline_ns, "written after its deadline"
        # SAF-002: no setpoint that was sent before a safe frame comes after it.
        assert not any(sent.at_ns <= safe.t_ns < entry.t_ns for safe in safes), "a setpoint after a safe frame"
        # SAF-007
        assert not any(start < sent.at_ns < end for start, end in history.locked), "written while locked out"
        assert not history.locked_since or sent.at_ns <= history.locked_since
    # SAF-008
    for crash_ns in history.crashes:
        resumed = min((resume_ns for resume_ns in history.resumes if resume_ns > crash_ns), default=2**62)
        for entry in written:
            if entry.kind in ("setpoint", "enable"):
                assert not crash_ns < entry.t_ns < resumed, "moved after a restart without a resume"


@settings(max_examples=100, deadline=None)
@given(st.lists(st.sampled_from(EVENTS), min_size=3, max_size=40))
def test_saf_001_002_006_007_008_009_hold_in_any_order(events: list[str]) -> None:
    play_and_judge(events)


@pytest.mark.long
@settings(max_examples=400, deadline=None)
@given(st.lists(st.sampled_from(EVENTS), min_size=3, max_size=40))
def test_saf_001_002_006_007_008_009_hold_in_many_orders(events: list[str]) -> None:
    play_and_judge(events)


def play_and_judge(events: list[str]) -> None:
    async def run() -> None:
        async with open_inline_tree() as tree:
            player = Player(tree)
            await player.play("resume")
            for event in events:
                await player.play(event)
            await trio.sleep(0.5)
            judge(player)

    run_virtual(run)
