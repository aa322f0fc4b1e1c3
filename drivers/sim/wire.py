"""The simulation control of a twin as a wire, and as the root's stop channel."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar

from strands_actors.contract.driver import MotorReport, Observation, Permit, StopChannel, Wire, WireDown
from strands_actors.drivers.common.simulation_control import protocol as p
from strands_actors.drivers.common.simulation_control.body import Hand
from strands_actors.drivers.common.simulation_control.client import Refusal, SimulationClient
from strands_actors.kernel.clock import NS, Clock
from strands_actors.kernel.messages import Refused

from .gates import HELD_BY_WIRE, LET_GO

if TYPE_CHECKING:
    from .driver import SimDriver

HANDSHAKE_S = 2.0
READ_S = 0.03
"""How long one reading waits; the next one asks again. The watchdog wants to hear of us."""

SILENT_S = 1.0
"""A simulation that says nothing for so long is gone."""

SAFE_S = 1.0


class SimWire(Wire):
    interruptible: ClassVar[bool] = True

    def __init__(self, driver: SimDriver, clock: Clock) -> None:
        self._driver = driver
        self._clock = clock
        self._control: SimulationClient | None = None
        self._beside: SimulationClient | None = None
        self._armed = False
        self._seen: Observation | None = None

    async def open(self) -> dict[str, Any]:
        self.close()
        self._control = SimulationClient(self._driver.port)
        axes = (await self._client.call(p.Handshake(0), p.Axes, HANDSHAKE_S)).axes
        if axes != self._driver.axes:
            raise WireDown(f"the simulation is of another robot: it has {', '.join(axes)}")
        self._observe(await self._client.call(p.Read(0), p.Sample, HANDSHAKE_S))
        return {"simulation": self._driver.port}

    async def arm(self, permit: Permit) -> Observation:
        permit.check()
        sample = await self._client.call(p.Take(0), p.Sample, HANDSHAKE_S)
        self._armed = True
        return self._observe(sample)

    async def read(self) -> Observation:
        client = self._client
        sample = await client.answer(client.ask(p.Read(0)), p.Sample, READ_S)
        if sample is not None:
            return self._observe(sample)
        seen = self._seen
        if seen is None or self._clock.now_ns() - seen.t_ns > SILENT_S * NS:
            raise WireDown(f"the simulation says nothing for {SILENT_S:g} s")
        return seen

    async def write(self, values: tuple[float, ...], permit: Permit) -> None:
        units = self._driver.units
        # what modifies a target (a gripper's speed) follows the axes, and has no meaning here
        aim = p.Aim(0, tuple((value - zero) / scale for value, (zero, scale) in zip(values, units, strict=False)))
        client = self._client
        permit.check()
        client.tell(aim)

    async def make_safe(self, safe_state: str) -> tuple[MotorReport, ...]:
        if self._control is None:
            return _failed(self._driver, "not connected")
        self._armed = self._armed and self._driver.energised(safe_state)
        return await _make_safe(self._driver, self._control, safe_state)

    async def perform(self, service: str, arguments: Mapping[str, Any], permit: Permit) -> dict[str, Any] | Refused:
        """``step``, in a conversation beside the readings'. A target written before is heard before."""
        permit.check()
        self._beside = beside = self._beside or SimulationClient(self._driver.port)
        try:
            step = p.Step(0, int(arguments.get("steps", 1)))
            sample = await beside.call(step, p.Sample, self._driver.SERVICES[service].within_s)
        except Refusal as refusal:
            return Refused("wire", f"{service}: {refusal}")
        return {"position": self._driver.as_json(self._position(sample)), "sim_time_s": sample.time_s}

    def close(self) -> None:
        for control in (self._control, self._beside):
            if control is not None:
                control.close()
        self._control = self._beside = self._seen = None
        self._armed = False

    @property
    def _client(self) -> SimulationClient:
        if self._control is None:
            raise WireDown("wire: not connected. Open it first")
        return self._control

    def _observe(self, sample: p.Sample) -> Observation:
        self._seen = self._observed(sample)
        return self._seen

    def _observed(self, sample: p.Sample) -> Observation:
        driver, now_ns = self._driver, self._clock.now_ns()
        return Observation(
            t_ns=now_ns,
            position=self._position(sample),
            stamp_ns=(now_ns,) * len(driver.units),
            velocity=tuple(
                scale * velocity for velocity, (_, scale) in zip(sample.velocity, driver.units, strict=True)
            ),
            sensors={"effort_nm": sample.effort, "sim_time_s": (sample.time_s,)},
            faults=_faults(driver.axes, sample.hands) if self._armed else {},
        )

    def _position(self, sample: p.Sample) -> tuple[float, ...]:
        return _position(self._driver, sample)


class SimStopChannel(StopChannel):
    """A conversation of the root's own, begun when it is needed."""

    def __init__(self, driver: SimDriver) -> None:
        self._driver = driver

    async def make_safe(self, safe_state: str) -> tuple[MotorReport, ...]:
        try:
            control = SimulationClient(self._driver.port)
        except WireDown as down:
            return _failed(self._driver, str(down))
        try:
            return await _make_safe(self._driver, control, safe_state)
        finally:
            control.close()

    def close(self) -> None:
        pass


async def _make_safe(driver: SimDriver, control: SimulationClient, safe_state: str) -> tuple[MotorReport, ...]:
    """``ask`` hands the frame over before anything waits."""
    try:
        sample = await control.call(p.Safe(0, driver.control_safe_state(safe_state)), p.Sample, SAFE_S)
    except WireDown as down:
        return _failed(driver, str(down))
    wire = int(Hand.WIRE)
    targets = _position(driver, sample) if driver.energised(safe_state) else (None,) * len(driver.axes)
    return tuple(
        MotorReport(axis, motor, True, True, hand != wire, HELD_BY_WIRE if hand == wire else "", target)
        for axis, motor, hand, target in zip(driver.axes, driver.ids, sample.hands, targets, strict=True)
    )


def _position(driver: SimDriver, sample: p.Sample) -> tuple[float, ...]:
    """In the driver's units."""
    return tuple(zero + scale * value for value, (zero, scale) in zip(sample.position, driver.units, strict=True))


def _failed(driver: SimDriver, why: str) -> tuple[MotorReport, ...]:
    return tuple(
        MotorReport(axis, motor, False, False, False, why)
        for axis, motor in zip(driver.axes, driver.ids, strict=True)
    )


def _faults(axes: Sequence[str], hands: Sequence[int]) -> dict[str, str]:
    words = {int(Hand.WIRE): HELD_BY_WIRE, int(Hand.NONE): LET_GO}
    return {axis: words[hand] for axis, hand in zip(axes, hands, strict=True) if hand in words}
