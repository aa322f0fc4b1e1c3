"""Supervision in virtual time: which children are restarted, when and how often, and in which order all
of them end.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

import pytest
import trio
from trio.testing import wait_all_tasks_blocked

from strands_actors.kernel.messages import Message
from strands_actors.kernel.supervisor import Budget, BudgetSpent, ChildSpec, Restart, Strategy, Supervisor

from .kernel import Boom, Number, Recorder, running_node, virtual_time

FREE = Budget(restarts=1000)


class Failed(Exception):
    pass


@dataclass
class Life:
    """One incarnation of a child. It is up after ``up_s`` and ends after ``lasts_s``, with or without an
    error.
    """

    lasts_s: float = float("inf")
    error: BaseException | None = None
    up_s: float = 0.0
    leaves_s: float = 0.0  # time to end after it is cancelled


@dataclass
class Stage:
    """Log the events of the children with their times."""

    log: list[tuple[float, str]] = field(default_factory=list)
    start_s: float = 0.0

    def note(self, event: str) -> None:
        self.log.append((round(trio.current_time() - self.start_s, 3), event))

    def times_of(self, event: str) -> list[float]:
        return [time_s for time_s, entry in self.log if entry == event]

    @property
    def events(self) -> list[str]:
        return [entry for _, entry in self.log]

    def child(self, name: str, *lives: Life, restart: Restart = "permanent", shutdown_s: float = 2.0) -> ChildSpec:
        """Make a child that has these lives, and then one without end."""
        script: Iterator[Life] = iter(lives)

        async def run(task_status: trio.TaskStatus[None]) -> None:
            life = next(script, Life())
            self.note(f"+{name}")
            try:
                if life.up_s:
                    await trio.sleep(life.up_s)
                if life.lasts_s > 0:
                    task_status.started()
                await trio.sleep(life.lasts_s)
                if life.error is not None:
                    raise life.error
            finally:
                if life.leaves_s:
                    with trio.CancelScope(shield=True):
                        await trio.sleep(life.leaves_s)
                self.note(f"-{name}")

        return ChildSpec(name, run, restart, shutdown_s)


async def run_for(stage: Stage, supervisor: Supervisor, seconds: float) -> bool:
    """Run the supervisor for at most so many seconds. Return whether it ended by itself."""
    stage.start_s = trio.current_time()
    with trio.move_on_after(seconds) as scope:
        await supervisor.run()
    return not scope.cancelled_caught


# -- strategies


@pytest.mark.parametrize(
    ("strategy", "expected"),
    [
        ("one_for_one", "+a +b +c | -b +b | -c -b -a"),
        ("rest_for_one", "+a +b +c | -b -c +b +c | -c -b -a"),
        ("one_for_all", "+a +b +c | -b -c -a +a +b +c | -c -b -a"),
    ],
)
@virtual_time
async def test_the_strategy_decides_which_siblings_are_restarted_too(strategy: Strategy, expected: str) -> None:
    stage = Stage()
    specs = [stage.child("a"), stage.child("b", Life(1.0, Failed("x"))), stage.child("c")]
    supervisor = Supervisor(specs, strategy)
    assert not await run_for(stage, supervisor, 5)
    assert stage.events == expected.replace("| ", "").split()
    members = {"one_for_one": "b", "rest_for_one": "bc", "one_for_all": "abc"}[strategy]
    assert supervisor.restarts == {name: int(name in members) for name in "abc"}
    assert stage.times_of("+b") == [0, 1]


@virtual_time
async def test_a_sibling_that_ends_while_it_is_stopped_counts_once() -> None:
    stage = Stage()
    specs = [stage.child("a", Life(1.0, Failed("x"))), stage.child("b", Life(1.0, Failed("y")))]
    supervisor = Supervisor(specs, "one_for_all", Budget(restarts=1))
    assert not await run_for(stage, supervisor, 5)
    assert supervisor.restarts == {"a": 1, "b": 1}


# -- restart kinds


@pytest.mark.parametrize(
    ("restart", "error", "again"),
    [
        ("permanent", None, True),
        ("permanent", Failed("x"), True),
        ("transient", None, False),
        ("transient", Failed("x"), True),
        ("temporary", None, False),
        ("temporary", Failed("x"), False),
    ],
)
@virtual_time
async def test_restart_kinds(restart: Restart, error: Exception | None, again: bool) -> None:
    stage = Stage()
    supervisor = Supervisor([stage.child("a", Life(1.0, error), restart=restart), stage.child("b")])
    assert not await run_for(stage, supervisor, 5)
    assert supervisor.restarts == {"a": int(again), "b": 0}


@virtual_time
async def test_a_supervisor_ends_with_its_last_child() -> None:
    stage = Stage()
    specs = [
        stage.child("a", Life(1.0), restart="transient"),
        stage.child("b", Life(2.0, Failed("x")), restart="temporary"),
    ]
    assert await run_for(stage, Supervisor(specs), 100)
    assert trio.current_time() - stage.start_s == pytest.approx(2.0)


@pytest.mark.parametrize("order", ["ab", "ba"])
@virtual_time
async def test_two_ends_at_the_same_time_are_both_handled(order: str) -> None:
    stage = Stage()
    made = {
        "a": stage.child("a", Life(1.0), restart="temporary"),
        "b": stage.child("b", Life(1.0, Failed("x")), restart="permanent"),
    }
    supervisor = Supervisor([made[name] for name in order])
    assert not await run_for(stage, supervisor, 5)
    assert supervisor.restarts == {"a": 0, "b": 1}


@virtual_time
async def test_a_temporary_child_is_not_started_again_with_its_siblings() -> None:
    stage = Stage()
    specs = [
        stage.child("a", Life(1.0), restart="temporary"),
        stage.child("b", restart="temporary"),
        stage.child("c", Life(2.0, Failed("x"))),
    ]
    supervisor = Supervisor(specs, "one_for_all")
    assert not await run_for(stage, supervisor, 5)
    assert supervisor.restarts == {"a": 0, "b": 0, "c": 1}
    assert stage.times_of("-b") == [2]


# -- the budget


@virtual_time
async def test_a_spent_budget_ends_all_children_and_gives_the_reason() -> None:
    stage = Stage()
    lives = [Life(1.0, Failed(f"x{number}")) for number in range(9)]
    supervisor = Supervisor([stage.child("a"), stage.child("b", *lives), stage.child("c")])
    stage.start_s = trio.current_time()
    match = r"b failed 4 times in 5 s: Failed: x3"
    with pytest.RaisesGroup(pytest.RaisesExc(BudgetSpent, match=match)) as caught:
        await supervisor.run()
    assert isinstance(caught.value.exceptions[0].__cause__, Failed)
    assert stage.times_of("+b") == [0, 1, 2, 3]
    assert stage.log[-3:] == [(4, "-b"), (4, "-c"), (4, "-a")]


@virtual_time
async def test_failures_far_apart_do_not_add_up() -> None:
    stage = Stage()
    lives = [Life(2.0, Failed("x")) for _ in range(50)]
    supervisor = Supervisor([stage.child("a", *lives)], budget=Budget(restarts=2, within_s=4.0))
    assert not await run_for(stage, supervisor, 99)
    assert supervisor.restarts == {"a": 49}


@virtual_time
async def test_a_budget_of_zero_gives_up_at_the_first_failure() -> None:
    stage = Stage()
    supervisor = Supervisor([stage.child("a", Life(1.0, Failed("x")))], budget=Budget(restarts=0))
    with pytest.RaisesGroup(pytest.RaisesExc(BudgetSpent, match="a failed 1 times in 5 s: Failed: x")):
        await supervisor.run()
    assert supervisor.restarts == {"a": 0}


@virtual_time
async def test_the_pause_doubles_up_to_its_limit_and_is_reset() -> None:
    stage = Stage()
    lives = [Life(0.1, Failed("x")) for _ in range(6)] + [Life(60.0, Failed("x"))] * 2
    budget = Budget(restarts=20, within_s=50.0, backoff_s=0.5, backoff_max_s=3.0)
    assert not await run_for(stage, Supervisor([stage.child("a", *lives)], budget=budget), 200)
    ended, begun = stage.times_of("-a"), stage.times_of("+a")
    pauses = [round(start - end, 3) for end, start in zip(ended, begun[1:], strict=False)]
    assert pauses == [0.5, 1.0, 2.0, 3.0, 3.0, 3.0, 0.5, 0.5]


@virtual_time
async def test_a_supervisor_can_be_stopped_during_a_pause() -> None:
    stage = Stage()
    specs = [stage.child("a"), stage.child("b", Life(1.0, Failed("x")))]
    supervisor = Supervisor(specs, budget=Budget(backoff_s=50.0, backoff_max_s=50.0))
    assert not await run_for(stage, supervisor, 10)
    assert stage.log == [(0, "+a"), (0, "+b"), (1, "-b"), (10, "-a")]


# # -- the start


@virtual_time
async def test_children_come_up_one_after_another() -> None:
    stage = Stage()
    specs = [stage.child("a", Life(up_s=1.0)), stage.child("b", Life(up_s=2.0)), stage.child("c")]
    supervisor = Supervisor(specs)
    async with trio.open_nursery() as nursery:
        stage.start_s = trio.current_time()
        await nursery.start(supervisor.run)
        assert trio.current_time() - stage.start_s == pytest.approx(3.0)
        nursery.cancel_scope.cancel()
    assert stage.log[:3] == [(0, "+a"), (1, "+b"), (3, "+c")]


@pytest.mark.parametrize("alone", [True, False])
@virtual_time
async def test_a_child_that_fails_before_it_is_up_is_started_again(alone: bool) -> None:
    stage = Stage()
    lives = [Life(0, Failed("x")), Life(0, Failed("y"), up_s=1.0)]
    specs = [stage.child("a", *lives)] if alone else [stage.child("a", *lives), stage.child("b")]
    supervisor = Supervisor(specs)
    assert not await run_for(stage, supervisor, 5)
    assert supervisor.restarts["a"] == 2


@virtual_time
async def test_a_child_that_never_comes_up_spends_the_budget() -> None:
    stage = Stage()
    restarts: list[tuple[str, str]] = []
    lives = [Life(0, Failed(f"x{number}")) for number in range(9)]
    specs = [stage.child("a", *lives), stage.child("b")]
    supervisor = Supervisor(specs, "one_for_all", on_restart=lambda name, why: restarts.append((name, why)))
    with pytest.RaisesGroup(pytest.RaisesExc(BudgetSpent, match="a failed 4 times in 5 s: Failed: x3")):
        await supervisor.run()
    assert stage.events.count("+a") == stage.events.count("+b") == 4
    assert restarts == [("a", "Failed: x0"), ("a", "Failed: x1"), ("a", "Failed: x2")]


@virtual_time
async def test_a_supervisor_can_be_stopped_while_a_child_comes_up() -> None:
    stage = Stage()
    specs = [stage.child("a"), stage.child("b", Life(up_s=1000.0)), stage.child("c")]
    assert not await run_for(stage, Supervisor(specs), 10)
    assert stage.log == [(0, "+a"), (0, "+b"), (10, "-b"), (10, "-a")]


@virtual_time
async def test_a_supervisor_can_be_stopped_while_a_child_comes_up_again() -> None:
    stage = Stage()
    specs = [stage.child("a"), stage.child("b", Life(1.0, Failed("x")), Life(up_s=1000.0)), stage.child("c")]
    assert not await run_for(stage, Supervisor(specs), 10)
    assert stage.log[3:] == [(1, "-b"), (1, "+b"), (10, "-c"), (10, "-b"), (10, "-a")]


# -- the end


@virtual_time
async def test_children_end_one_after_another_in_reverse() -> None:
    stage = Stage()
    specs = [stage.child(name, Life(leaves_s=1.0)) for name in "abc"]
    assert not await run_for(stage, Supervisor(specs), 10)
    assert stage.log[3:] == [(11, "-c"), (12, "-b"), (13, "-a")]


@virtual_time
async def test_each_child_has_its_own_deadline_to_end() -> None:
    stage = Stage()
    specs = [
        stage.child("a", Life(leaves_s=1.0)),
        stage.child("b", Life(leaves_s=50.0), shutdown_s=3.0),
        stage.child("c", Life(leaves_s=50.0), shutdown_s=0.5),
    ]
    assert not await run_for(stage, Supervisor(specs), 10)
    assert stage.log[3:] == [(14.5, "-a"), (60, "-c"), (60.5, "-b")]


@virtual_time
async def test_an_exception_of_a_child_that_is_stopped_changes_nothing() -> None:
    ended: list[str] = []

    async def bad(task_status: trio.TaskStatus[None]) -> None:
        task_status.started()
        try:
            await trio.sleep_forever()
        except trio.Cancelled:
            raise Failed("at the end") from None

    async def good(task_status: trio.TaskStatus[None]) -> None:
        task_status.started()
        try:
            await trio.sleep_forever()
        finally:
            ended.append("good")

    with trio.move_on_after(1):
        await Supervisor([ChildSpec("good", good), ChildSpec("bad", bad)]).run()
    assert ended == ["good"]


# # -- callbacks, nested supervisors and actors


@virtual_time
async def test_the_callback_gets_the_name_and_the_reason() -> None:
    stage = Stage()
    restarts: list[tuple[float, str, str]] = []

    def on_restart(name: str, why: str) -> None:
        stage.note("restart reported")
        restarts.append((round(trio.current_time() - stage.start_s, 3), name, why))

    specs = [stage.child("a", Life(1.0, Failed("no fuse")), Life(1.0)), stage.child("b", Life(1.5, Failed()))]
    supervisor = Supervisor(specs, on_restart=on_restart)
    assert not await run_for(stage, supervisor, 5)
    assert restarts == [(1, "a", "Failed: no fuse"), (1.5, "b", "Failed"), (2, "a", "ended")]
    assert stage.events[3:5] == ["+a", "restart reported"]  # after the child is up again


@virtual_time
async def test_a_spent_budget_of_a_nested_supervisor_is_a_failure_in_its_parent() -> None:
    stage = Stage()
    restarts: list[str] = []
    inner_runs = 0

    async def inner(task_status: trio.TaskStatus[None]) -> None:
        nonlocal inner_runs
        inner_runs += 1
        lives = [Life(1.0, Failed("x"))] * (9 if inner_runs == 1 else 0)
        specs = [stage.child("a"), stage.child("b", *lives)]
        await Supervisor(specs, budget=Budget(restarts=1)).run(task_status)

    outer = Supervisor(
        [stage.child("first"), ChildSpec("inner", inner), stage.child("last")],
        "rest_for_one",
        on_restart=lambda name, why: restarts.append(f"{name}: {why}"),
    )
    assert not await run_for(stage, outer, 10)
    assert restarts == ["inner: BudgetSpent: b failed 2 times in 5 s: Failed: x"]
    assert stage.log == [
        (0, "+first"), (0, "+a"), (0, "+b"), (0, "+last"),
        (1, "-b"), (1, "+b"),
        (2, "-b"), (2, "-a"), (2, "-last"),
        (2, "+a"), (2, "+b"), (2, "+last"),
        (10, "-last"), (10, "-b"), (10, "-a"), (10, "-first"),
    ]  # fmt: skip


@virtual_time
async def test_an_actor_keeps_its_mailbox_and_loses_its_state() -> None:
    """Waiting messages are handled by the next incarnation. The message that made the actor fail is not
    handled again.
    """
    async with running_node() as (node, nursery):
        logs: list[list[Message]] = []

        def factory() -> Recorder:
            logs.append([])
            return Recorder(logs[-1])

        cell = node.cell("r/actor/recorder", factory)
        supervisor = Supervisor([ChildSpec("recorder", cell.run)], budget=Budget(backoff_s=1.0))
        await nursery.start(supervisor.run)
        ref = node.ref(cell.address, Recorder)
        for message in (Number(1), Boom("x"), Number(2), Number(3)):
            ref.tell(message)
        await trio.sleep(0.5)
        ref.tell(Number(4))  # while no incarnation runs
        assert cell.state == "stopped"
        assert len(logs) == 1
        answer = await ref.ask(Number(5), 5.0)
        assert answer == Number(5)
        await wait_all_tasks_blocked()
        assert logs == [[Number(1), Boom("x")], [Number(2), Number(3), Number(4), Number(5)]]
        assert cell.incarnations == 2
        assert supervisor.restarts == {"recorder": 1}


@virtual_time
async def test_a_child_may_be_any_async_function() -> None:
    calls = 0

    async def plain(task_status: Any) -> None:
        nonlocal calls
        calls += 1
        task_status.started()
        task_status.started()  # harmless
        if calls < 3:
            raise Failed("x")

    done: Callable[..., Any] = plain
    await Supervisor([ChildSpec("plain", done, "transient")], budget=FREE).run()
    assert calls == 3
