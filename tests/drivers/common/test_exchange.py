"""Test the matching of answers to requests: late, repeated, unasked and lost answers, and several callers."""

from __future__ import annotations

from collections import deque
from itertools import islice

import pytest
import trio
import trio.testing
from hypothesis import given
from hypothesis import strategies as st

from strands_actors.contract.wire import WireDown
from strands_actors.drivers.common.ports.exchange import PAUSE_S, Exchange, numbers
from strands_actors.kernel.clock import NS

from .memory_port import virtual

MOST = 4


class Line:
    """A connection. Each ``receive`` takes the next piece of data, which has any number of answers."""

    def __init__(self) -> None:
        self.exchange: Exchange[int, str, str] = Exchange(MOST)
        self.readers = 0
        self.lost = False
        self._pieces: deque[tuple[tuple[int, str], ...]] = deque()
        self._arrived = trio.Condition()

    async def arrives(self, *answers: tuple[int, str]) -> None:
        async with self._arrived:
            self._pieces.append(answers)
            self._arrived.notify_all()

    async def breaks(self) -> None:
        async with self._arrived:
            self.lost = True
            self._arrived.notify_all()

    async def receive(self) -> None:
        self.readers += 1
        assert self.readers == 1, "two callers read at the same time"
        try:
            async with self._arrived:
                while not self._pieces:
                    if self.lost:
                        raise WireDown("the connection is gone")
                    await self._arrived.wait()
                for number, answer in self._pieces.popleft():
                    self.exchange.take(number, answer)
        finally:
            self.readers -= 1

    def ask(self, number: int) -> None:
        self.exchange.sent(number, f"request {number}", awaited=True)

    async def answer(self, number: int, within_s: float = 1.0) -> str | None:
        return await self.exchange.answer(number, within_s, self.receive)


# -- one caller


def test_answers_come_in_any_order_and_in_one_piece() -> None:
    async def main() -> None:
        line = Line()
        for number in (1, 2, 3):
            line.ask(number)
        assert line.exchange.unanswered == 3
        await line.arrives((3, "three"), (1, "one"), (2, "two"))
        assert [await line.answer(number) for number in (1, 2, 3)] == ["one", "two", "three"]
        assert line.exchange.unanswered == 0

    virtual(main)


def test_no_answer_comes_in_time_and_the_wait_can_go_on() -> None:
    async def main() -> None:
        line = Line()
        line.ask(1)
        began_s = trio.current_time()
        assert await line.answer(1, 0.3) is None
        assert trio.current_time() - began_s == pytest.approx(0.3)
        assert line.exchange.waits_for(1)
        await line.arrives((1, "late"))
        assert await line.answer(1, 0.3) == "late"

    virtual(main)


def test_an_answer_that_is_there_needs_no_wait() -> None:
    async def main() -> None:
        line = Line()
        line.ask(1)
        line.exchange.take(1, "one")
        with trio.CancelScope() as scope:
            scope.cancel()
            assert await line.answer(1, 0.0) == "one"

    virtual(main)


def test_a_late_answer_is_dropped_once_its_caller_has_left() -> None:
    line: Exchange[int, str, str] = Exchange()
    line.sent(1, "request", awaited=True)
    line.forget(1)
    assert line.unanswered == 1, "the peer still owes the answer"
    sent = line.take(1, "late")
    assert sent is not None and sent.request == "request" and not sent.is_awaited
    assert line.pop(1) is None and line.unanswered == 0


def test_an_answer_that_has_arrived_is_dropped_once_its_caller_has_left() -> None:
    line: Exchange[int, str, str] = Exchange()
    line.sent(1, "request", awaited=True)
    line.take(1, "answer")
    line.forget(1)
    assert line.pop(1) is None and line.unanswered == 0


def test_an_answer_that_comes_twice_counts_once() -> None:
    line: Exchange[int, str, str] = Exchange()
    line.sent(1, "request", awaited=True)
    assert line.take(1, "first") is not None
    assert line.take(1, "second") is None
    assert line.pop(1) == "first"
    assert line.pop(1) is None
    assert line.take(1, "third") is None
    assert line.pop(1) is None


def test_an_answer_without_a_request_is_dropped() -> None:
    async def main() -> None:
        line = Line()
        line.ask(7)
        await line.arrives((8, "of another client"), (0, ""), (-7, "wrong"))
        assert await line.answer(7, 0.1) is None
        assert line.exchange.request(8) is None and line.exchange.pop(8) is None
        await line.arrives((7, "right"))
        assert await line.answer(7) == "right"

    virtual(main)


def test_an_answer_for_which_no_caller_waits_is_not_kept() -> None:
    line: Exchange[int, str, str] = Exchange()
    line.sent(1, "request")
    assert not line.waits_for(1)
    sent = line.take(1, "answer")
    assert sent is not None and sent.request == "request"
    assert line.pop(1) is None


# -- numbers


def test_numbers_start_again_after_the_last() -> None:
    assert list(islice(numbers(3), 7)) == [1, 2, 3, 1, 2, 3, 1]


def test_a_number_that_is_used_again_belongs_to_the_new_request() -> None:
    line: Exchange[int, str, str] = Exchange(MOST)
    line.sent(1, "old", awaited=True)
    line.take(1, "old answer")
    line.sent(1, "new", awaited=True)
    assert line.pop(1) is None, "the old answer is not the answer to the new request"
    assert line.request(1) == "new" and line.waits_for(1)
    line.sent(1, "newer")
    assert line.unanswered == 1 and not line.waits_for(1)


def test_the_age_of_a_number_that_is_used_again_counts_from_its_new_request() -> None:
    line: Exchange[int, str, str] = Exchange(2)
    line.sent(1, "old")
    line.sent(2, "second")
    line.sent(1, "new")
    line.sent(3, "third")
    assert [line.request(number) for number in (1, 2, 3)] == ["new", None, "third"], "the oldest was replaced"


# -- several callers


def test_one_reads_for_all() -> None:
    async def main() -> None:
        line, received = Line(), dict[int, str | None]()

        async def wait(number: int) -> None:
            received[number] = await line.answer(number)

        for number in (1, 2, 3):
            line.ask(number)
        async with trio.open_nursery() as nursery:
            for number in (1, 2, 3):
                nursery.start_soon(wait, number)
            await trio.testing.wait_all_tasks_blocked()
            assert line.readers == 1
            await line.arrives((2, "two"))
            await trio.testing.wait_all_tasks_blocked()
            assert received == {2: "two"} and line.readers == 1
            await line.arrives((3, "three"), (1, "one"))
        assert received == {1: "one", 2: "two", 3: "three"} and line.readers == 0

    virtual(main)


@pytest.mark.parametrize("cancelled", [1, 2])
def test_a_caller_that_is_cancelled_leaves_the_others_served(cancelled: int) -> None:
    """The first caller is the one that reads. The others continue without it, and its answer is dropped."""

    async def main() -> None:
        line, received, scopes = Line(), dict[int, str | None](), dict[int, trio.CancelScope]()

        async def wait(number: int) -> None:
            with trio.CancelScope() as scopes[number]:
                try:
                    received[number] = await line.answer(number, 10.0)
                finally:
                    line.exchange.forget(number)

        for number in (1, 2, 3):
            line.ask(number)
        async with trio.open_nursery() as nursery:
            for number in (1, 2, 3):
                nursery.start_soon(wait, number)
                await trio.testing.wait_all_tasks_blocked()
            scopes[cancelled].cancel()
            await trio.testing.wait_all_tasks_blocked()
            assert line.readers == 1
            await line.arrives((1, "one"), (2, "two"), (3, "three"))
        others = {1: "one", 2: "two", 3: "three"}
        del others[cancelled]
        assert received == others
        assert line.exchange.unanswered == 0 and line.exchange.pop(cancelled) is None

    virtual(main)


def test_each_caller_has_its_own_deadline() -> None:
    async def main() -> None:
        line, ended_s = Line(), dict[int, float]()

        async def wait(number: int, within_s: float) -> None:
            assert await line.answer(number, within_s) is None
            ended_s[number] = trio.current_time()

        line.ask(1)
        line.ask(2)
        async with trio.open_nursery() as nursery:
            nursery.start_soon(wait, 1, 0.2)
            nursery.start_soon(wait, 2, 0.5)
        assert ended_s[2] - ended_s[1] == pytest.approx(0.3)

    virtual(main)


def test_a_lost_connection_ends_every_wait() -> None:
    async def main() -> None:
        line, failed = Line(), list[int]()

        async def wait(number: int) -> None:
            with pytest.raises(WireDown, match="the connection is gone"):
                await line.answer(number, 10.0)
            failed.append(number)

        async with trio.open_nursery() as nursery:
            for number in (1, 2, 3):
                line.ask(number)
                nursery.start_soon(wait, number)
            await trio.testing.wait_all_tasks_blocked()
            began_s = trio.current_time()
            await line.breaks()
        assert sorted(failed) == [1, 2, 3] and trio.current_time() == began_s
        with pytest.raises(WireDown, match="gone"):
            await line.exchange.until(lambda: False, line.receive)

    virtual(main)


def test_a_replaced_connection_ends_every_wait_and_forgets_all_answers() -> None:
    async def main() -> None:
        line, failed = Line(), list[int]()

        async def wait(number: int) -> None:
            with pytest.raises(WireDown, match="lost before the answer"):
                await line.answer(number, 10.0)
            failed.append(number)

        line.ask(4)
        line.exchange.take(4, "arrived before")
        async with trio.open_nursery() as nursery:
            for number in (1, 2, 3):
                line.ask(number)
                nursery.start_soon(wait, number)
                await trio.testing.wait_all_tasks_blocked()
            line.exchange.clear()
            await trio.testing.wait_all_tasks_blocked()
            # The first caller still reads from the old connection until that is closed.
            assert sorted(failed) == [2, 3]
            await line.arrives((1, "of the old connection"))
        assert sorted(failed) == [1, 2, 3]
        assert line.exchange.pop(4) is None and line.exchange.unanswered == 0

    virtual(main)


def test_a_wait_for_several_ends_with_the_first_answer() -> None:
    async def main() -> None:
        line = Line()
        line.ask(1)
        line.ask(2)
        await line.arrives((2, "two"))
        began_s = trio.current_time()
        await line.exchange.wait(1.0, line.receive, 1, 2)
        assert trio.current_time() == began_s
        assert line.exchange.pop(1) is None and line.exchange.pop(2) == "two"

    virtual(main)


# -- answers that never come


def test_memory_is_bounded_if_no_answer_comes_and_if_no_answer_is_fetched() -> None:
    line: Exchange[int, str, str] = Exchange(MOST)
    for number in range(1000):
        line.sent(number, "request", awaited=True)
    assert line.unanswered == MOST
    assert line.request(995) is None and line.take(995, "too late") is None
    for number in range(1000):
        line.sent(number, "request", awaited=True)
        line.take(number, "never fetched")
        assert len(line._answers) <= MOST
    assert line.pop(995) is None and line.pop(996) == "never fetched"


def test_a_caller_of_a_request_that_was_replaced_does_not_wait_for_ever() -> None:
    async def main() -> None:
        line = Line()
        for number in range(MOST + 1):
            line.ask(number)
        with pytest.raises(WireDown, match="lost"):
            await line.answer(0, 60.0)

    virtual(main)


def test_old_requests_expire_unless_a_caller_waits_for_them() -> None:
    line: Exchange[int, str, str] = Exchange(MOST)
    line.sent(1, "old", 100)
    line.sent(2, "old but awaited", 100, awaited=True)
    line.sent(3, "new", 200)
    line.expire(200)
    assert [line.request(number) for number in (1, 2, 3)] == [None, "old but awaited", "new"]
    line.forget(2)
    line.expire(200)
    assert line.request(2) is None and line.request(3) == "new"


# -- silence

S = round(NS)


def test_a_peer_is_silent_from_its_first_unanswered_request_or_its_last_answer() -> None:
    line: Exchange[int, str, str] = Exchange()
    assert line.silent_s(50 * S) == 0.0, "it was not asked"
    line.sent(1, "request", 50 * S)
    line.sent(2, "request", 50 * S + S // 10)
    assert line.silent_s(50 * S + S // 2) == pytest.approx(0.5)
    line.take(1, "answer")
    line.received(50 * S + S // 2)
    assert line.silent_s(51 * S) == pytest.approx(0.5), "the second request is unanswered"
    line.take(2, "answer")
    line.received(51 * S)
    assert line.silent_s(60 * S) == 0.0, "every request is answered"
    line.sent(3, "request", 60 * S)
    assert line.silent_s(61 * S) == pytest.approx(1.0)
    line.sent(4, "request", 61 * S)
    for number in (3, 4):
        line.take(number, "answer")
        line.received(61 * S)
    line.sent(5, "request", 61 * S + S // 5)
    assert line.silent_s(62 * S) == pytest.approx(0.8), "until then every request was answered"


def test_a_pause_between_requests_is_no_silence_of_the_peer() -> None:
    line: Exchange[int, str, str] = Exchange()
    line.sent(1, "its answer is lost", 0)
    after_ns = round((PAUSE_S + 0.01) * NS)
    line.sent(2, "request", after_ns)
    assert line.silent_s(after_ns) == 0.0


def test_a_peer_that_answers_nothing_is_silent_however_often_it_is_asked() -> None:
    line: Exchange[int, str, str] = Exchange(MOST)
    for number in range(100):
        line.sent(number, "request", number * S // 100)
    assert line.silent_s(S) == pytest.approx(1.0)


# -- any order of events

STEPS = st.lists(
    st.tuples(st.sampled_from(["ask", "tell", "answer", "forget", "pop", "clear"]), st.integers(0, 5)), max_size=60
)


@given(STEPS)
def test_no_answer_is_ever_taken_for_anothers(steps: list[tuple[str, int]]) -> None:
    """Every answer is fetched at most once, and only by the request that was sent before it, with its number."""
    line: Exchange[int, int, tuple[int, int]] = Exchange(MOST)
    newest: dict[int, int] = {}  # the time of the newest request with each number
    awaited: dict[int, bool] = {}
    for time, (step, number) in enumerate(steps):
        match step:
            case "ask" | "tell":
                line.sent(number, time, awaited=step == "ask")
                newest[number], awaited[number] = time, step == "ask"
            case "answer":
                sent = line.take(number, (number, newest.get(number, -1)))
                assert sent is None or (sent.request, sent.is_awaited) == (newest[number], awaited[number])
            case "forget":
                line.forget(number)
                awaited[number] = False
            case "pop":
                answer = line.pop(number)
                assert answer is None or (awaited[number] and answer == (number, newest[number]))
                if answer is not None:
                    assert line.pop(number) is None and line.take(number, answer) is None
            case "clear":
                line.clear()
                assert line.unanswered == 0 and not any(map(line.waits_for, range(6)))
        assert line.unanswered <= MOST and len(line._answers) <= MOST
