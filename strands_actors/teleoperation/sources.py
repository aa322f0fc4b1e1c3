"""The sources of a leader's frames. They run in the process of the teleoperation, which may be killed
together with them."""

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
"""Lifetime of an operator's input. Without newer input the dead-man counts as released."""


class Reading(NamedTuple):
    """One reading of a leader.

    Attributes:
        t_ns: Time of the measurement; 0 if there is no complete reading.
        values: Values by axis.
        held: True if the leader's own dead-man is held; None if the leader has no dead-man.
    """

    t_ns: int
    values: Mapping[str, float]
    held: bool | None = None


class Source(Protocol):
    """A source of readings. Calls never overlap."""

    READINGS: int
    """Number of readings per control period."""

    async def open(self) -> None:
        """Connect to the leader. Raise ``WireDown``."""

    async def read(self) -> Reading:
        """Return the newest reading. Raise ``WireDown`` if the leader is lost."""

    def close(self) -> None: ...


class Arm:
    """A leader arm on its bus. It is opened, made limp, and read, and its wire energises nothing.

    It is read three times per period (1 to 3 ms of its bus each). At 100 Hz a change then waits for at most
    4 ms instead of 10 ms.
    """

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
        # An earlier program may have left torque on the motors, and the arm could not be moved by hand.
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
    """An object with ``get_action()``, such as a teleoperator of lerobot.

    ``get_action()`` returns positions by joint, under ``x`` or ``x.pos``. The object may block, so it is made
    and read in threads.
    """

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
            return Reading(0, {})  # This is not a frame. A leader without frames soon counts as silent.
        return Reading(asked_ns, numbers)

    def close(self) -> None:
        made, self._object = self._object, None
        if callable(disconnect := getattr(made, "disconnect", None)):
            disconnect()


def _plain(value: Any) -> Any:
    return value.item() if callable(getattr(value, "item", None)) else value


class Operator:
    """The input of an operator at a keyboard or a page: rates by axis, and a dead-man."""

    READINGS = 1

    def __init__(self, axes: tuple[str, ...], clock: Clock) -> None:
        self._rest = dict.fromkeys(axes, 0.0)
        self._clock = clock
        self._told = Operate(0, False)

    def take(self, told: Operate) -> None:
        """Take new input. Its lifetime counts from its own time, so late input expires earlier."""
        if told.t_ns >= self._told.t_ns:
            self._told = told

    @property
    def held(self) -> bool:
        """Return True if the dead-man is held now."""
        return self._told.held and 0 <= self._clock.now_ns() - self._told.t_ns <= OPERATOR_NS

    @property
    def let_go(self) -> bool:
        """Return True if the operator has reported the release of the dead-man.

        Silence is no release: a silent operator may still hold it, for example while this process stood
        still. When input comes again, it must not count as a new press.
        """
        return self._told.t_ns > 0 and not self._told.held

    async def open(self) -> None:
        return None

    async def read(self) -> Reading:
        now_ns = self._clock.now_ns()
        if not self.held:
            return Reading(now_ns, self._rest, held=False)
        rates = {key: rate for key, rate in self._told.rates.items() if key in self._rest}
        return Reading(now_ns, {**self._rest, **rates}, held=True)

    def close(self) -> None:
        return None


def made_of(source: Mapping[str, Any]) -> Callable[[], Any]:
    """Return a function that makes the object of a source, by its ``module:factory``."""
    return lambda: load(source["factory"])(**source.get("options", {}))
