"""A replay makes the same decisions as the robot, in virtual time, and reports each difference."""

from __future__ import annotations

import random
from collections.abc import Awaitable, Callable

import msgspec
import pytest
import trio

from strands_actors.contract.driver import Reason
from strands_actors.kernel.messages import Refused
from strands_actors.supervisors.gate import failsafe, gate, lease
from strands_actors.supervisors.gate.messages import Accepted, Beat, Observed, Resume, Stop
from strands_actors.supervisors.instrument import Kind
from strands_actors.supervisors.wire.messages import RootGone
from strands_actors.surfaces.recording import RecordingError
from strands_actors.surfaces.recording.file import Recording, entries_of
from strands_actors.surfaces.recording.player import Outcome, replay
from strands_actors.surfaces.recording.rows import Gap, Journal
from strands_actors.testing import run_virtual
from strands_actors.testing.fake import HARDWARE, FakeDriver, FakeHardware
from tests.tree.test_machine import EVENTS, Player
from tests.tree.writer import armed

from .tape import Tape, open_tape

Play = Callable[[Tape], Awaitable[None]]


def recorded(play: Play, before: Play | None = None) -> Recording:
    """Return the recording of ``play``. ``before`` runs first and is not recorded."""
    made: list[Recording] = []

    async def run() -> None:
        async with open_tape() as tape:
            if before is not None:
                await before(tape)
            await tape.attach()
            await play(tape)
            await tape.detach()
            made.append(tape.recording())

    run_virtual(run)
    return made[0]


def again(recording: Recording) -> Outcome:
    HARDWARE["replay"] = FakeHardware()
    try:
        return replay(recording, FakeDriver("fake", "replay", {}))
    finally:
        del HARDWARE["replay"]


async def lively(tape: Tape) -> None:
    writer = await armed(tape.tree)
    for value in (1.0, 2.0):
        assert isinstance(await writer.send(a=value), Accepted)
        await trio.sleep(0.03)
    refused = await writer.send(a=1000.0)
    assert isinstance(refused, Refused)
    await trio.sleep(0.2)  # the setpoint expires: hold
    await writer.acquire()
    assert isinstance(await writer.send(latched=True, b=5.0), Accepted)
    writer.ref.tell(Beat(writer.lease.id))
    await trio.sleep(1.5)  # the lease expires: hold
    await tape.tree.gate.ask(Stop(Reason.ESTOP, "op", lock=True), 1.0)
    assert isinstance(await writer.send(a=1.0), Refused)
    await tape.tree.gate.ask(Resume(), 1.0)
    await trio.sleep(0.1)


def test_a_lively_run_is_replayed_without_a_difference() -> None:
    outcome = again(recorded(lively))
    assert outcome.equal, outcome.difference
    assert outcome.steps > 300 and outcome.effects > 300
    assert (outcome.gaps, outcome.skipped) == (0, 0)


@pytest.mark.parametrize("seed", range(6))
def test_any_order_of_events_is_replayed_without_a_difference(seed: int) -> None:
    order = random.Random(seed)
    events = order.choices([event for event in EVENTS if event != "crash"], k=25)  # a crash ends the process

    async def play(tape: Tape) -> None:
        player = Player(tape.tree)
        for event in ("resume", *events):
            await player.play(event)

    async def head(tape: Tape) -> None:
        player = Player(tape.tree)
        for event in ("resume", "setpoint"):
            await player.play(event)

    outcome = again(recorded(play, before=head if seed % 2 else None))
    assert outcome.equal, outcome.difference


def test_a_recording_may_begin_in_the_middle_of_a_stop() -> None:
    """A sender that waits for an answer at that time is answered in the replay, too."""

    async def begin(tape: Tape) -> None:
        await armed(tape.tree)
        tape.tree.gate.tell(Stop(Reason.STOP))
        tape.tree.gate.tell(Resume())
        while tape.tree.hardware.of("safe") == []:  # noqa: ASYNC110  # a frame causes no event
            await trio.sleep(0.0005)

    async def rest(_: Tape) -> None:
        await trio.sleep(0.2)

    recording = recorded(rest, before=begin)
    kinds = {entry.kind for part in recording.parts if isinstance(part, Journal) for entry in entries_of(part)}
    assert Kind.SETTLED in kinds
    outcome = again(recording)
    assert outcome.equal, outcome.difference


def test_the_loss_of_the_root_is_replayed() -> None:
    async def play(tape: Tape) -> None:
        await armed(tape.tree)
        robot = tape.tree.gate.address.split("/")[1]
        tape.tree.node.ref(f"strands/{robot}/actor/watchdog").tell(RootGone())
        await trio.testing.wait_all_tasks_blocked()

    recording = recorded(play)
    assert any(
        b"Leave" in bytes(entry.body)
        for part in recording.parts
        if isinstance(part, Journal)
        for entry in entries_of(part)
    )
    assert again(recording).equal


# -- differences that a replay reports


def test_another_limit_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    recording = recorded(lively)
    monkeypatch.setattr("strands_actors.testing.fake.LIMIT", 2000.0)
    outcome = again(recording)
    difference = outcome.difference
    assert not outcome.equal and difference is not None
    assert difference.actor == "gate" and "a: 1000.0" in difference.message
    assert any("code='range'" in line for line in difference.recorded), difference
    assert any(line.startswith("answers: Accepted") for line in difference.replayed)
    assert any(line.startswith("tells transport: Write") for line in difference.replayed)


def test_a_shorter_lease_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    recording = recorded(lively)
    monkeypatch.setattr(lease, "LEASE_TTL_NS", 500_000_000)
    difference = again(recording).difference
    assert difference is not None and difference.message.startswith("Probe")
    assert any("MakeSafe" in line for line in difference.replayed)
    assert not any("MakeSafe" in line for line in difference.recorded)


def test_another_transition_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    recording = recorded(lively)
    table = dict(failsafe.TRANSITIONS)
    row = table[failsafe.Mode.ARMED, failsafe.Event.HOLD]
    table[failsafe.Mode.ARMED, failsafe.Event.HOLD] = row._replace(raises=False)
    monkeypatch.setattr(failsafe, "TRANSITIONS", table)
    assert not again(recording).equal


def test_a_gate_that_reads_the_clock_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    recording = recorded(lively)
    observed = gate.Gate._observed

    def impure(self: gate.Gate, message: Observed) -> None:
        self.context.clock.now_ns()
        observed(self, message)

    monkeypatch.setattr(gate.Gate, "_observed", impure)
    difference = again(recording).difference
    assert difference is not None and "clock" in difference.replayed[0]


# -- gaps


def test_behind_a_gap_it_goes_on_from_the_next_memory() -> None:
    async def play(tape: Tape) -> None:
        await lively(tape)
        await tape.attach(session=2)
        await lively(tape)

    recording = recorded(play)
    (second,) = [
        at
        for at, part in enumerate(recording.parts)
        if isinstance(part, Journal) and (part.session, part.number) == (2, 1)
    ]
    whole = again(recording)
    torn = Recording(
        recording.info,
        # the first session loses its end, in the middle of a message's effects, or a little later
        [*recording.parts[: second - 3], Gap("wire", -1, "lost"), *recording.parts[second:]],
    )
    outcome = again(torn)
    assert outcome.equal, outcome.difference
    assert outcome.gaps == 1 and 0 < outcome.steps < whole.steps


def test_without_a_memory_nothing_is_compared() -> None:
    recording = recorded(lively)
    headless = Recording(recording.info, recording.parts[1:])
    outcome = again(headless)
    assert outcome.equal and outcome.steps == 0 and outcome.skipped > 300


def test_a_memory_of_another_version_is_refused() -> None:
    recording = recorded(lively)
    first = recording.parts[0]
    assert isinstance(first, Journal)
    entries = [
        msgspec.structs.replace(entry, body=msgspec.Raw(msgspec.msgpack.encode({"state": 1})))
        if entry.kind == Kind.MEMORY
        else entry
        for entry in entries_of(first)
    ]
    other = Journal(first.source, first.session, first.number, msgspec.msgpack.encode(entries))
    with pytest.raises(RecordingError, match="cannot be decoded by this version"):
        again(Recording(recording.info, [other]))
