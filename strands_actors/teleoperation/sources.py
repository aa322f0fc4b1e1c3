"""The sources of a leader's readings: a leader arm, an object of another library, or an operator's input.

They run in the process of the teleoperation. If a source hangs, this process can be killed together with it.
"""

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
        held: True if a dead-man that is part of the leader is held; None if the leader has no dead-man.
    """

    t_ns: int
    values: Mapping[str, float]
    held: bool | None = None


class Source(Protocol):
    """A source of a leader's readings. Its methods are never called at the same time."""

    READINGS: int
    """Number of readings per control period."""

    async def open(self) -> None:
        """Connect to the leader. Raise ``WireDown`` if it cannot be reached."""

    async def read(self) -> Reading:
        """Return the newest reading. Raise ``WireDown`` if the leader is lost."""

    def close(self) -> None: ...


class Arm:
    """A leader arm on its servo bus. It is opened, its torque is switched off, and it is read. Its motors never get
    torque.

    The arm is read three times per control period. Each reading occupies the bus for 1 to 3 ms. At 100 Hz a change
    then waits for at most 4 ms instead of 10 ms.
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
        # An earlier program may have left torque on the motors. Then a person could not move the arm.
        reports = await wire.make_safe(SafeState.LIMP)
        if stiff := [report.axis for report in reports if not report.safe]:
            self.close()
            raise WireDown(f"{self._driver.robot}: {', '.join(stiff)} may have torque. Check cables and power")

    async def read(self) -> Reading:
        if self._wire is None:
            raise WireDown(f"{self._driver.robot}: not open")
        observed = await self._wire.read()
        oldest_ns = min(observed.stamp_ns)
        if not oldest_ns:
            return Reading(0, {})
        return Reading(oldest_ns, self._driver.as_json(observed.position))

    def close(self) -> None:
        wire, self._wire = self._wire, None
        if wire is not None:
            wire.close()


class LeaderObject:
    """An object with ``get_action()``, such as a teleoperator of lerobot.

    ``get_action()`` returns positions by joint, with keys ``x`` or ``x.pos``. A call of the object may block, so
    its methods run in worker threads.
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
            raise TypeError(f"{type(made).__name__} has no get_action. Give a teleoperator")
        if callable(connect := getattr(made, "connect", None)):
            connect()
        return made

    async def read(self) -> Reading:
        requested_ns = self._clock.now_ns()
        action = await trio.to_thread.run_sync(self._object.get_action, abandon_on_cancel=True)
        if not isinstance(action, Mapping):
            raise TypeError(f"the leader's get_action returned {type(action).__name__}, not a mapping of joints")
        values = {str(key).removesuffix(".pos"): value for key, value in action.items()}
        numbers = {key: number for key, value in values.items() if (number := finite(_plain(value))) is not None}
        if len(numbers) != len(values):
            return Reading(0, {})  # a value is missing, so send no frame; the leader soon counts as silent
        return Reading(requested_ns, numbers)

    def close(self) -> None:
        made, self._object = self._object, None
        if callable(disconnect := getattr(made, "disconnect", None)):
            disconnect()


def _plain(value: Any) -> Any:
    return value.item() if callable(getattr(value, "item", None)) else value


class Leaders:
    """Several leaders that are read together. ``leaders`` are their sources, by the prefix of their part's axes."""

    READINGS = 1

    def __init__(self, leaders: Mapping[str, Source]) -> None:
        self._leaders = leaders

    async def open(self) -> None:
        for leader in self._leaders.values():
            await leader.open()

    async def read(self) -> Reading:
        readings: dict[str, Reading] = {}

        async def read(prefix: str, leader: Source) -> None:
            readings[prefix] = await leader.read()

        try:
            async with trio.open_nursery() as nursery:
                for prefix, leader in self._leaders.items():
                    nursery.start_soon(read, prefix, leader)
        except* WireDown as lost:
            raise _first(lost) from None
        oldest_ns = min(reading.t_ns for reading in readings.values())
        if not oldest_ns:
            return Reading(0, {})
        return Reading(
            oldest_ns,
            {prefix + key: value for prefix, each in readings.items() for key, value in each.values.items()},
        )

    def close(self) -> None:
        for leader in self._leaders.values():
            leader.close()


def _first(group: BaseExceptionGroup[WireDown]) -> WireDown:
    """Return the first exception of a group, which may contain groups."""
    failure: BaseException = group
    while isinstance(failure, BaseExceptionGroup):
        failure = failure.exceptions[0]
    assert isinstance(failure, WireDown)
    return failure


class Operator:
    """The input of an operator at a keyboard or a web page: a speed for each axis, and a dead-man."""

    READINGS = 1

    def __init__(self, axes: tuple[str, ...], clock: Clock) -> None:
        self._rest = dict.fromkeys(axes, 0.0)
        self._clock = clock
        self._input = Operate(0, False)

    def take(self, new_input: Operate) -> None:
        """Store new input of the operator.

        It expires a fixed time after it was made, so input that arrives late expires earlier.
        """
        if new_input.t_ns >= self._input.t_ns:
            self._input = new_input

    @property
    def held(self) -> bool:
        """Return True if the dead-man is held now."""
        return self._input.held and 0 <= self._clock.now_ns() - self._input.t_ns <= OPERATOR_NS

    @property
    def let_go(self) -> bool:
        """Return True if the operator has reported the release of the dead-man.

        Silence is not a release: the operator may still hold the dead-man, for example if this process was frozen
        for a moment. The next input must then not count as a new press.
        """
        return self._input.t_ns > 0 and not self._input.held

    async def open(self) -> None:
        return None

    async def read(self) -> Reading:
        now_ns = self._clock.now_ns()
        if not self.held:
            return Reading(now_ns, self._rest, held=False)
        rates = {key: rate for key, rate in self._input.rates.items() if key in self._rest}
        return Reading(now_ns, {**self._rest, **rates}, held=True)

    def close(self) -> None:
        return None


def made_of(source: Mapping[str, Any]) -> Callable[[], Any]:
    """Return a function that makes the leader object, from the ``module:factory`` in its description ``source``."""
    return lambda: load(source["factory"])(**source.get("options", {}))
