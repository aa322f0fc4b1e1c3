"""Where a leader's frames come from. Each lives in the process of the teleoperation, which may be
killed with it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple, Protocol

import trio

from strands_actors.contract.axis import finite
from strands_actors.contract.loading import load
from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.wire import Wire, WireDown
from strands_actors.kernel.clock import Clock
from strands_actors.supervisors.loading import load_driver
from strands_actors.supervisors.root.messages import Operate

OPERATOR_NS = 200_000_000
"""So long what an operator does at a keyboard stands: one that is gone has let go."""


class Reading(NamedTuple):
    """``held``: what the leader itself says of its dead-man; None: it has none."""

    t_ns: int
    values: Mapping[str, float]
    held: bool | None = None


class Source(Protocol):
    """Calls never overlap. ``READINGS``: how often it is read in a period."""

    READINGS: int

    async def open(self) -> None:
        """Raise ``WireDown``."""

    async def read(self) -> Reading:
        """The newest. Raise ``WireDown`` when it is gone."""

    def close(self) -> None: ...


class Arm:
    """A leader arm on its bus: opened, made limp, and read. Its wire energises nothing. It is read
    three times in a period (1 to 3 ms of its bus each): a change waits for 4 ms at most at 100 Hz, not
    for 10."""

    READINGS = 3

    def __init__(self, description: Mapping[str, Any], clock: Clock) -> None:
        self._driver = load_driver(dict(description))
        self._clock = clock
        self._wire: Wire | None = None

    async def open(self) -> None:
        self.close()
        wire = self._driver.open_wire(self._clock)
        await wire.open()
        self._wire = wire
        # Whoever had it before may have left torque on it: it could not be moved by hand.
        reports = await wire.make_safe(SafeState.LIMP)
        if stiff := [report.axis for report in reports if not report.safe]:
            self.close()
            raise WireDown(f"{self._driver.robot}: {', '.join(stiff)} may have torque. Check cables and power")

    async def read(self) -> Reading:
        if self._wire is None:
            raise WireDown(f"{self._driver.robot}: not open")
        seen = await self._wire.read()
        oldest_ns = min(seen.stamp_ns)
        if not oldest_ns:
            return Reading(0, {})
        return Reading(oldest_ns, self._driver.as_json(seen.position))

    def close(self) -> None:
        wire, self._wire = self._wire, None
        if wire is not None:
            wire.close()


class Asked:
    """An object with ``get_action()``, as lerobot's teleoperators have it: positions by joint,
    ``x`` or ``x.pos``. It is made and asked in threads: it may block."""

    READINGS = 1

    def __init__(self, make: Callable[[], Any], clock: Clock) -> None:
        self._make = make
        self._clock = clock
        self._object: Any = None

    async def open(self) -> None:
        self._object = await trio.to_thread.run_sync(self._connected, abandon_on_cancel=True)

    def _connected(self) -> Any:
        made = self._make()
        if not callable(getattr(made, "get_action", None)):
            raise TypeError(f"{type(made).__name__} is no teleoperator: it has no get_action")
        if callable(connect := getattr(made, "connect", None)):
            connect()
        return made

    async def read(self) -> Reading:
        asked_ns = self._clock.now_ns()
        action = await trio.to_thread.run_sync(self._object.get_action, abandon_on_cancel=True)
        if not isinstance(action, Mapping):
            raise TypeError(f"its get_action returned {type(action).__name__}, not an action")
        values = {str(key).removesuffix(".pos"): value for key, value in action.items()}
        numbers = {key: number for key, value in values.items() if (number := finite(_plain(value))) is not None}
        if len(numbers) != len(values):
            return Reading(0, {})  # no frame: who sends none for long is silent
        return Reading(asked_ns, numbers)

    def close(self) -> None:
        made, self._object = self._object, None
        if callable(disconnect := getattr(made, "disconnect", None)):
            disconnect()


def _plain(value: Any) -> Any:
    return value.item() if callable(getattr(value, "item", None)) else value


class Operator:
    """What somebody does at a keyboard or on a page: rates by axis, and a dead-man."""

    READINGS = 1

    def __init__(self, axes: tuple[str, ...], clock: Clock) -> None:
        self._rest = dict.fromkeys(axes, 0.0)
        self._clock = clock
        self._told = Operate(0, False)

    def take(self, told: Operate) -> None:
        """Be told something new. What came late stands no longer than if it had not."""
        if told.t_ns >= self._told.t_ns:
            self._told = told

    @property
    def held(self) -> bool:
        """Whether the dead-man is held now."""
        return self._told.held and 0 <= self._clock.now_ns() - self._told.t_ns <= OPERATOR_NS

    @property
    def let_go(self) -> bool:
        """Whether the operator has said that it is not held: who is silent (or was not heard, for
        this process stood still) may hold it still, and that is no new press."""
        return self._told.t_ns > 0 and not self._told.held

    async def open(self) -> None:
        return None

    async def read(self) -> Reading:
        now_ns = self._clock.now_ns()
        if not self.held:
            return Reading(now_ns, self._rest, held=False)
        known = {key: rate for key, rate in self._told.rates.items() if key in self._rest}
        return Reading(now_ns, {**self._rest, **known}, held=True)

    def close(self) -> None:
        return None


def made_of(source: Mapping[str, Any]) -> Callable[[], Any]:
    """Return what makes the object of a source by ``module:factory``."""
    return lambda: load(source["factory"])(**source.get("options", {}))
