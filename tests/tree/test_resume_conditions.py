"""The answers of ``resume()`` for an armed robot with a broken condition, and the cause of a stop that is
kept. In virtual time.
"""

from __future__ import annotations

import contextlib
import itertools
from collections.abc import AsyncIterator

import msgspec
import pytest
import trio
import trio.testing

from strands_actors.contract.driver import Condition, OnResume, Reason
from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.wire import MotorReport, Observation, Permit
from strands_actors.kernel.clock import NS, Clock
from strands_actors.kernel.messages import Refused
from strands_actors.supervisors.gate.cause import SOON_NS, Cause, Lapse, Rank
from strands_actors.supervisors.gate.messages import Accepted, Resume, Resumed, Stop, StopReport
from strands_actors.testing import FakeHardware, InlineTree, open_inline_tree, run_virtual
from strands_actors.testing.fake import HARDWARE, FakeDriver, FakeWire

from .writer import Writer, armed

_ports = itertools.count()

WORDS: dict[str, dict[str, str]] = {}
"""The faults that each port's robot reports, with their texts. Arming repairs ``script``, a service
repairs ``begun``, and a person must repair the others.
"""


class WordyWire(FakeWire):
    """Report the words of ``WORDS`` as faults with each reading."""

    port = ""

    @property
    def words(self) -> dict[str, str]:
        return WORDS[self.port]

    async def arm(self, permit: Permit) -> Observation:
        self.words.pop("script", None)
        return self._with_words(await super().arm(permit))

    async def read(self) -> Observation:
        return self._with_words(await super().read())

    async def make_safe(self, safe_state: SafeState) -> tuple[MotorReport, ...]:
        reports = await super().make_safe(safe_state)
        if safe_state != SafeState.HOLD and "ends_script" in self.words:
            self.words["script"] = "the script is not running"
        return reports

    def _with_words(self, seen: Observation) -> Observation:
        return msgspec.structs.replace(seen, faults={name: word for name, word in self.words.items() if word})


def _condition(name: str, on_resume: OnResume, always: bool = False) -> Condition:
    def check(observation: Observation, now_ns: int) -> Refused | None:
        word = observation.faults.get(name)
        return None if word is None else Refused(name, word, "mend it")

    return Condition(check, always=always, on_resume=on_resume)


@contextlib.asynccontextmanager
async def tree_with_words(always: bool = False) -> AsyncIterator[tuple[InlineTree, dict[str, str], Writer]]:
    port = f"wordy-{next(_ports)}"
    hardware = HARDWARE[port] = FakeHardware()
    words = WORDS[port] = {}

    class Wordy(FakeDriver):
        def open_wire(self, clock: Clock) -> WordyWire:
            wire = WordyWire(hardware, clock)
            wire.port = port
            return wire

    driver = Wordy("fake", port, {})
    driver.conditions = (
        _condition("error", OnResume.REFUSE, always),
        _condition("script", OnResume.ARM_ANEW, always),
        _condition("begun", OnResume.STAY_ARMED),
    )
    try:
        async with open_inline_tree(hardware, driver=driver) as tree:
            yield tree, words, await armed(tree)
    finally:
        del HARDWARE[port], WORDS[port]


async def resume(tree: InlineTree) -> object:
    return await tree.gate.ask(Resume("test"), 5.0)


async def next_reading() -> None:
    await trio.sleep(0.05)


def test_saf_023_resume_of_an_armed_robot_with_a_broken_condition_is_refused() -> None:
    async def run() -> None:
        async with tree_with_words() as (tree, words, writer):
            words["error"] = "protective stop"
            await next_reading()
            answer = await resume(tree)
            assert isinstance(answer, Refused) and answer.code == "error"
            assert answer.text == "resume: protective stop. Mend it"
            words.clear()
            await next_reading()
            assert isinstance(await resume(tree), Resumed), "after the remedy no stop is needed"
            await writer.acquire()
            assert isinstance(await writer.send(a=1.0), Accepted)

    run_virtual(run)


def test_saf_023_a_condition_that_arming_repairs_needs_only_a_resume() -> None:
    async def run() -> None:
        async with tree_with_words() as (tree, words, writer):
            words["script"] = "the script is not running"
            await next_reading()
            assert isinstance(refused := await writer.send(a=1.0), Refused) and refused.code == "script"
            before_ns = tree.node.clock.now_ns()
            answer = await resume(tree)
            assert isinstance(answer, Resumed)
            assert next(entry.kind for entry in tree.hardware.written if entry.t_ns >= before_ns) == "safe"
            assert (await tree.status()).mode == "armed"
            await writer.acquire()
            assert isinstance(await writer.send(a=1.0), Accepted)

    run_virtual(run)


def test_saf_023_a_condition_for_a_person_is_reported_before_one_that_arming_repairs() -> None:
    async def run() -> None:
        async with tree_with_words() as (tree, words, _):
            words |= {"script": "the script is not running", "error": "protective stop"}
            await next_reading()
            before_ns = tree.node.clock.now_ns()
            answer = await resume(tree)
            assert isinstance(answer, Refused) and answer.code == "error"
            assert tree.hardware.of("safe", before_ns) == [], "an arm that a person must repair is not armed again"
            del words["error"]
            await next_reading()
            assert isinstance(await resume(tree), Resumed)

    run_virtual(run)


def test_a_robot_with_a_condition_that_a_service_repairs_stays_armed() -> None:
    async def run() -> None:
        async with tree_with_words() as (tree, words, _):
            words["begun"] = "it stands on the floor"
            await next_reading()
            assert isinstance(await resume(tree), Resumed)
            assert (await tree.status()).mode == "armed"

    run_virtual(run)


def test_saf_009_a_stop_wins_over_a_resume_that_arms_again() -> None:
    async def run() -> None:
        async with tree_with_words() as (tree, words, _):
            words["script"] = "the script is not running"
            await next_reading()
            answers: list[object] = []

            async def resume_now() -> None:
                answers.append(await resume(tree))

            async with trio.open_nursery() as nursery:
                nursery.start_soon(resume_now)
                await trio.testing.wait_all_tasks_blocked()
                report = await tree.gate.ask(Stop(Reason.STOP, "a person"), 1.0)
            assert isinstance(report, StopReport) and report.confirmed
            await trio.sleep(0.5)
            assert (await tree.status()).mode == "disarmed"
            assert isinstance(answers[0], Refused) and answers[0].code == "stopped"

    run_virtual(run)


def test_an_error_shortly_after_a_stop_replaces_its_cause() -> None:
    async def run() -> None:
        async with tree_with_words(always=True) as (tree, words, writer):
            assert isinstance(await writer.send(latched=True, a=1.0), Accepted)
            words["script"] = "the arm stands"
            await tree.until("disarmed", within_s=1.0)
            assert (await tree.status()).cause == "the arm stands"
            words["error"] = "error 31: collision"
            await trio.sleep(0.1)
            assert (await tree.status()).cause == "error 31: collision"
            refused = await writer.send(a=1.0)
            assert isinstance(refused, Refused) and "error 31: collision" in refused.text

    run_virtual(run)


def test_an_expired_command_does_not_hide_a_fault_at_the_same_time(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Otherwise a peer on the mesh could continue without a resume."""
    now_ns = 5 * NS
    expired = Cause("the setpoint expired", Reason.EXPIRED, Rank.LATE, now_ns + SOON_NS, lapse=Lapse.EXPIRED)
    monkeypatch.setitem(HARDWARE, "fake-cause", FakeHardware())
    driver = FakeDriver("fake", "fake-cause", {})
    driver.conditions = ()
    seen = Observation(now_ns, (0.0, 0.0), (now_ns, now_ns), faults={"elbow": "overload"})
    assert expired.refined(driver, msgspec.structs.replace(seen, faults={}), now_ns) is expired
    cause = expired.refined(driver, seen, now_ns)
    assert (cause.text, cause.lapse) == ("elbow: overload", Lapse.NONE)
    driver.conditions = (_condition("elbow", OnResume.REFUSE),)
    assert expired.refined(driver, seen, now_ns).lapse == Lapse.NONE


def test_an_error_later_than_a_fifth_of_a_second_does_not_replace_the_cause() -> None:
    async def run() -> None:
        async with tree_with_words(always=True) as (tree, words, writer):
            assert isinstance(await writer.send(latched=True, a=1.0), Accepted)
            words["script"] = "the arm stands"
            await tree.until("disarmed", within_s=1.0)
            await trio.sleep(0.3)
            words["error"] = "error 31: collision"
            await trio.sleep(0.1)
            assert (await tree.status()).cause == "the arm stands"

    run_virtual(run)


def test_a_person_s_stop_stays_the_cause_when_an_error_follows() -> None:
    async def run() -> None:
        async with tree_with_words(always=True) as (tree, words, writer):
            words["ends_script"] = ""
            assert isinstance(await writer.send(latched=True, a=1.0), Accepted)
            await tree.gate.ask(Stop(Reason.STOP, "a person"), 1.0)
            words["error"] = "error 31: collision"
            await trio.sleep(0.1)
            assert (await tree.status()).cause == "stop by a person"

    run_virtual(run)


def test_a_condition_that_the_stop_itself_breaks_is_not_its_cause() -> None:
    async def run() -> None:
        async with tree_with_words() as (tree, words, writer):
            words["ends_script"] = ""
            assert isinstance(await writer.send(latched=True, a=1.0), Accepted)
            tree.hardware.answers = False
            await tree.until("lost", within_s=1.0)
            tree.hardware.answers = True
            await tree.until("disarmed", within_s=5.0)
            await trio.sleep(0.1)
            assert (await tree.status()).cause.startswith("the link was lost")

    run_virtual(run)


def test_a_fault_that_the_robot_reports_is_more_specific_than_a_lost_link() -> None:
    async def run() -> None:
        async with tree_with_words() as (tree, words, writer):
            tree.driver.conditions = ()
            assert isinstance(await writer.send(latched=True, a=1.0), Accepted)
            tree.hardware.answers = False
            await tree.until("lost", within_s=1.0)
            words["elbow"] = "overload"
            tree.hardware.answers = True
            await tree.until("disarmed", within_s=5.0)
            await trio.sleep(0.1)
            assert (await tree.status()).cause == "elbow: overload"

    run_virtual(run)
