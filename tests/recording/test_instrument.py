"""The instrument does nothing without a recorder. It uses bounded memory with one, and reports each gap."""

from __future__ import annotations

import msgspec
import pytest
import trio

from strands_actors.contract.driver import Reason
from strands_actors.kernel.messages import Message, Refused
from strands_actors.supervisors import instrument as instrument
from strands_actors.supervisors.gate.messages import Accepted, Probe, Stop, StopReport
from strands_actors.supervisors.instrument import (
    BATCH_BYTES,
    SILENT_S,
    WINDOW,
    Attach,
    Detach,
    Detached,
    Entry,
    Journal,
    Kind,
    Taken,
)
from strands_actors.testing import run_virtual
from tests.tree.writer import armed

from .tape import open_tape

GATE = "strands/r/actor/gate"
decode = msgspec.msgpack.Decoder(Entry).decode


class Long(Message, frozen=True):
    text: str


def journal(memories: list[tuple[str, int, object]] | None = None) -> Journal:
    made = Journal({GATE: "gate"}, frozenset({StopReport}), lambda: memories or [])
    made.begin(7)
    return made


def taken(from_: Journal) -> list[Entry]:
    return [decode(raw) for raw in from_.take(9)]


# -- the journal by itself


def test_the_effects_of_an_actor_follow_the_message_that_caused_them() -> None:
    made = journal([("gate", 3, Probe(1, 2))])
    made.took(GATE, 10, Probe(5, 6))
    made.sent(GATE, "strands/r/actor/transport", Probe(7, 8))
    made.answered(GATE, None)
    made.deferred(GATE, 4)
    made.took("strands/r/actor/transport", 11, Probe(9, 9))  # no request caused this one
    made.settled(GATE, 4, Refused("code", "why"))
    assert [(entry.kind, entry.actor, entry.at_ns, entry.number, entry.to) for entry in taken(made)] == [
        (Kind.MEMORY, "gate", 7, 3, ""),
        (Kind.TOOK, "gate", 10, 0, ""),
        (Kind.SENT, "gate", 0, 0, "transport"),
        (Kind.DEFERRED, "gate", 0, 4, ""),
        (Kind.SETTLED, "gate", 0, 4, ""),
    ]
    assert made.empty and taken(made) == []


def test_entries_that_do_not_fit_are_counted_and_the_memory_is_recorded_again(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(instrument, "CAPACITY", 4)
    memories: list[tuple[str, int, object]] = [("gate", 0, Probe(1, 1))]
    made = journal(memories)
    for number in range(10):
        made.took(GATE, 100 + number, Probe(number, 0))
    memories[0] = ("gate", 0, Probe(2, 2))
    seen = taken(made)
    assert [entry.kind for entry in seen] == [Kind.MEMORY, *[Kind.TOOK] * 3, Kind.GAP, Kind.MEMORY]
    assert seen[4].number == 7
    assert msgspec.msgpack.decode(seen[5].body) == ["Probe", 2, 2]
    made.took(GATE, 200, Probe(0, 0))
    assert [entry.kind for entry in taken(made)] == [Kind.TOOK]


def test_the_memory_is_that_of_the_moment() -> None:
    stops: list[int] = [1]
    made = journal([("gate", 0, stops)])
    stops.append(2)
    assert msgspec.msgpack.decode(taken(made)[0].body) == [1]


def test_batches_are_short_and_a_too_long_entry_is_a_gap() -> None:
    made = journal()
    for number in range(6):
        made.took(GATE, number + 1, Long("x" * 5000))
    sizes = []
    while batch := made.take(9):
        sizes.append(sum(len(memoryview(raw)) for raw in batch))
    assert len(sizes) == 2 and max(sizes) <= BATCH_BYTES
    made.took(GATE, 1, Long("x" * instrument.ENTRY_BYTES))
    made.took(GATE, 2, Probe(1, 1))
    (gap,) = taken(made)
    assert (gap.kind, gap.number) == (Kind.GAP, 2)


def test_a_memory_too_long_for_a_batch_is_left_out() -> None:
    assert taken(journal([("gate", 0, "x" * instrument.ENTRY_BYTES)])) == []


# -- the keeper


def test_there_is_no_instrument_without_a_recorder() -> None:
    async def run() -> None:
        async with open_tape() as tape:
            assert tape.tree.node.instrument is None
            await tape.attach()
            assert tape.tree.node.instrument is not None
            await trio.sleep(0.3)
            await tape.detach()
            assert tape.tree.node.instrument is None
            seen = len(tape.entries)
            await trio.sleep(0.3)
            assert len(tape.entries) == seen

    run_virtual(run)


def test_batches_are_numbered_and_complete() -> None:
    async def run() -> None:
        async with open_tape() as tape:
            await tape.attach()
            writer = await armed(tape.tree)
            assert isinstance(await writer.send(a=1.0), Accepted)
            await trio.sleep(0.2)
            await tape.detach()
            assert [batch.number for batch in tape.taker.batches] == list(range(1, len(tape.taker.batches) + 1))
            kinds = [(entry.kind, entry.actor) for entry in tape.entries]
            assert set(kinds[:2]) == {(Kind.MEMORY, "gate"), (Kind.MEMORY, "watchdog")}
            assert Kind.GAP not in {kind for kind, _ in kinds}

    run_virtual(run)


def test_a_stop_is_shipped_at_once() -> None:
    async def run() -> None:
        async with open_tape() as tape:
            await tape.attach()
            await armed(tape.tree)
            await tape.tree.gate.ask(Stop(Reason.STOP), 1.0)
            await trio.testing.wait_all_tasks_blocked()
            bodies = [bytes(entry.body) for entry in tape.entries if entry.kind == Kind.SENT]
            assert any(b"MakeSafe" in body for body in bodies)

    run_virtual(run)


def test_a_recorder_that_reads_nothing_gets_a_few_batches_and_is_dropped() -> None:
    async def run() -> None:
        async with open_tape() as tape:
            tape.taker.reads = False
            await tape.attach()
            await armed(tape.tree)
            await trio.sleep(SILENT_S * 0.9)
            assert len(tape.taker.batches) == WINDOW
            assert tape.tree.node.instrument is not None
            await trio.sleep(SILENT_S * 0.2)
            assert tape.tree.node.instrument is None
            assert len(tape.taker.batches) == WINDOW
            assert (await tape.tree.status()).mode == "armed"
            refused = await tape.ask(Detach(tape.session))
            assert isinstance(refused, Refused) and refused.code == "given_up", "it did not receive the rest"

    run_virtual(run)


def test_a_slow_recorder_gets_one_gap_and_the_memory_after_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(instrument, "CAPACITY", 100)

    async def run() -> None:
        async with open_tape() as tape:
            await tape.attach()
            await trio.sleep(0.1)
            tape.taker.reads = False
            await trio.sleep(SILENT_S * 0.8)
            tape.taker.reads = True
            tape.node.ref(tape.instrument).tell(instrument.Acknowledge(tape.session, tape.taker.batches[-1].number))
            await trio.sleep(0.2)
            await tape.detach()
            kinds = [entry.kind for entry in tape.entries]
            at = kinds.index(Kind.GAP)
            assert tape.entries[at].number > 100
            assert kinds[at + 1 : at + 3] == [Kind.MEMORY, Kind.MEMORY]
            assert kinds.count(Kind.GAP) == 1 and Kind.TOOK in kinds[at:]

    run_virtual(run)


def test_a_second_recorder_is_refused_by_the_name_of_the_first() -> None:
    async def run() -> None:
        async with open_tape() as tape:
            await tape.attach()
            refused = await tape.ask(Attach("strands/other/actor/wire", 1, "another"))
            assert isinstance(refused, Taken) and refused.by == "a test"
            before = tape.tree.node.instrument
            await tape.attach(session=2)  # the same recorder may start again
            assert tape.tree.node.instrument is not before

    run_virtual(run)


def test_another_format_is_refused() -> None:
    async def run() -> None:
        async with open_tape() as tape:
            refused = await tape.ask(Attach(tape.at, 1, "a test", instrument.FORMAT + 1))
            assert isinstance(refused, Refused) and refused.code == "format"
            assert tape.tree.node.instrument is None

    run_virtual(run)


def test_an_unreachable_recorder_is_dropped_soon() -> None:
    async def run() -> None:
        async with open_tape() as tape:
            await tape.attach(at="strands/nowhere/actor/wire")
            await trio.sleep(SILENT_S * 1.2)
            assert tape.tree.node.instrument is None

    run_virtual(run)


def test_detaching_twice_is_harmless() -> None:
    async def run() -> None:
        async with open_tape() as tape:
            await tape.attach()
            await tape.detach()
            assert isinstance(await tape.ask(Detach(tape.session)), Detached)

    run_virtual(run)


def test_a_failure_of_the_recording_does_not_disturb_the_robot(monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(_: Journal, now_ns: int) -> tuple[msgspec.Raw, ...]:
        raise RuntimeError("encoding failed")

    monkeypatch.setattr(Journal, "take", broken)

    async def run() -> None:
        async with open_tape() as tape:
            await tape.attach()
            writer = await armed(tape.tree)
            assert isinstance(await writer.send(a=1.0), Accepted)
            assert tape.tree.node.instrument is None
            assert any("encoding failed" in letter.reason for letter in tape.tree.node.dead_letters)

    run_virtual(run)
