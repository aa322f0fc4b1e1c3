"""Take a gate out of a driver, and send the command that it refuses to the twin: the robot's own fault must show.

A twin that accepts everything would hide a broken gate. Each wire has a table of rows, one for each of its gates
and conditions. If the real robot has no fault of its own for such a command, the row gives the reason. Such a gate
is the only protection, and nothing else would notice its loss.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Mapping, Sequence
from typing import Any, Generic, NamedTuple, Protocol, TypeVar

import pytest

from strands_actors.contract.driver import Candidate, Driver, GateState
from strands_actors.kernel.messages import Refused


class Bench(Protocol):
    """A driver, and the twin to which the driver's own code sends."""

    driver: Driver

    async def state(self) -> GateState:
        """Return the input of the gates: what the driver observes of the twin now."""
        ...

    async def send(self, values: tuple[float, ...]) -> None:
        """Send a target to the twin, as the wire does, and let the time of its motion pass."""
        ...

    def fault(self) -> str:
        """Return the fault that the twin shows by itself. Empty if it shows none."""
        ...


BenchT = TypeVar("BenchT", bound=Bench)


async def _nothing(bench: Any) -> None: ...


class Row(NamedTuple, Generic[BenchT]):
    """One gate or condition that is taken out.

    Attributes:
        gate: The name of its function.
        action: The action that it refuses.
        shows: A part of the fault that the twin then shows.
        no_fault: Why the real robot has no fault of its own. Either this or ``shows`` is given.
        prepare: Brings the bench to the state in which the gate refuses.
        also: Further gates that refuse the same action, and are taken out too.
        send: Sends the target in another way than ``Bench.send``.
    """

    gate: str
    action: Mapping[str, Any]
    shows: str = ""
    no_fault: str = ""
    prepare: Callable[[BenchT], Awaitable[None]] = _nothing
    also: tuple[str, ...] = ()
    send: Callable[[BenchT, tuple[float, ...]], Awaitable[None]] | None = None


Check = Callable[[GateState, Candidate | None], Refused | None]


def checks(driver: Driver) -> dict[str, Check]:
    """Return the driver's conditions and gates by the names of their functions, in their order."""
    named: dict[str, Check] = {}
    for condition in driver.conditions:
        named[_name(condition.check)] = lambda state, _, check=condition.check: check(  # type: ignore[misc]
            state.observation, state.now_ns
        )
    for gate in driver.gates:
        named[_name(gate)] = lambda state, candidate, gate=gate: candidate and gate(candidate, state)  # type: ignore[misc]
    return named


def _name(check: Callable[..., Any]) -> str:
    return getattr(check, "__name__", type(check).__name__)


def take_out(driver: Driver, names: Sequence[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """Remove gates and conditions from a driver."""
    conditions = tuple(one for one in driver.conditions if _name(one.check) not in names)
    gates = tuple(one for one in driver.gates if _name(one) not in names)
    monkeypatch.setattr(driver, "conditions", conditions)
    monkeypatch.setattr(driver, "gates", gates)


async def judge(row: Row[BenchT], bench: BenchT, monkeypatch: pytest.MonkeyPatch) -> None:
    """Show that the gate refuses the row's action, take it out, send the command, and compare the twin's fault."""
    await row.prepare(bench)
    state = await bench.state()
    parsed = bench.driver.parse(row.action, state)
    assert isinstance(parsed, Candidate), parsed
    by_name = checks(bench.driver)
    for name in (row.gate, *row.also):
        assert by_name[name](state, parsed) is not None, f"{name} accepts {row.action}"
    take_out(bench.driver, (row.gate, *row.also), monkeypatch)
    others = {name: check(state, parsed) for name, check in checks(bench.driver).items()}
    assert not any(others.values()), f"another gate refuses it: {others}"
    assert bench.fault() == "" or row.prepare is not _nothing
    await (row.send(bench, parsed.values) if row.send is not None else bench.send(parsed.values))
    shown = bench.fault()
    assert bool(row.shows) != bool(row.no_fault), "a row names a fault, or why there is none"
    if row.no_fault:
        assert shown == "", f"{row.gate}: the twin shows {shown}"
    else:
        assert row.shows in shown, f"{row.gate}: the twin shows {shown or 'nothing'}"


def assert_complete(driver: Driver, rows: Sequence[Row[Any]]) -> None:
    """Assert that the table has a row for each gate and each condition of the driver."""
    assert {row.gate for row in rows} == set(checks(driver)), "each gate has a row"
