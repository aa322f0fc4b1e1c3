"""Connect the wire process to a simulated robot, by the simulation control, the socket for requests to the
simulation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import trio

from strands_actors.contract.rotations import roll_pitch_yaw
from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.wire import MotorReport, Observation, Permit, Wire, WireDown
from strands_actors.drivers.common.kit.outcome import NOT_CONNECTED
from strands_actors.drivers.common.physics.body import Commander
from strands_actors.drivers.common.simulation_control import protocol as p
from strands_actors.drivers.common.simulation_control.client import Refusal, SimulationClient
from strands_actors.kernel.clock import NS, Clock
from strands_actors.kernel.messages import Refused

from . import refusals
from .config import SimConfig
from .gates import HELD_BY_WIRE, NOT_ENERGISED
from .stop_channel import make_safe

HANDSHAKE_S = 2.0
READ_S = 0.03
"""Longest wait for one reading, in seconds. It is short, since the watchdog expects ``read`` to return soon."""

SILENT_S = 5.0
"""A simulation that does not answer for this many seconds counts as lost. The first picture keeps it busy for two
seconds on a loaded machine. If its process ends, this is noticed at once."""


class SimWire(Wire):
    interruptible: ClassVar[bool] = True

    def __init__(self, config: SimConfig, clock: Clock) -> None:
        self._config = config
        self._clock = clock
        self._control: SimulationClient | None = None
        self._beside: SimulationClient | None = None
        self._armed = False
        self._observation: Observation | None = None
        self._read_since: trio.Event | None = None
        """Set by the first reading that was requested after a service was carried out."""

    async def open(self) -> dict[str, Any]:
        self.close()
        self._control = SimulationClient(self._config.control)
        axes = (await self._client.call(p.Handshake(0), p.Axes, HANDSHAKE_S)).axes
        if axes != self._config.axes:
            raise WireDown(f"the simulation has another robot, with the axes {', '.join(axes)}")
        self._observe(await self._client.call(p.Read(0), p.Sample, HANDSHAKE_S))
        return {"simulation": self._config.control}

    async def arm(self, permit: Permit) -> Observation:
        permit.check()
        sample = await self._client.call(p.Take(0), p.Sample, HANDSHAKE_S)
        self._armed = True
        return self._observe(sample)

    async def read(self) -> Observation:
        client, read_since = self._client, self._read_since
        sample = await client.answer(client.ask(p.Read(0)), p.Sample, READ_S)
        if sample is not None:
            if read_since is not None:
                read_since.set()
            return self._observe(sample)
        observation = self._observation
        if observation is None or self._clock.now_ns() - observation.t_ns > SILENT_S * NS:
            raise WireDown(f"the simulation did not answer for {SILENT_S:g} s")
        return observation

    async def write(self, values: tuple[float, ...], permit: Permit) -> None:
        aim = p.Aim(0, self._config.model(values))
        client = self._client
        permit.check()
        client.tell(aim)

    async def make_safe(self, safe_state: SafeState) -> tuple[MotorReport, ...]:
        if self._control is None:
            return NOT_CONNECTED.reports(self._config.axes, self._config.ids)
        self._armed = self._armed and safe_state in self._config.energised
        return await make_safe(self._config, self._control, safe_state)

    async def perform(self, service: str, arguments: Mapping[str, Any], permit: Permit) -> dict[str, Any] | Refused:
        """Run ``step`` or ``reset`` over a second connection, so that readings continue on the first one.

        The simulation first handles the targets that were sent earlier. The call returns only after a reading that
        shows the result, so that the caller's next observation shows it, too.
        """
        permit.check()
        if service == "reset" and self._armed:
            return refusals.energised()
        self._beside = beside = self._beside or SimulationClient(self._config.control)
        try:
            request = p.Reset(0) if service == "reset" else p.Step(0, int(arguments.get("steps", 1)))
            sample = await beside.call(request, p.Sample, p.STEP_S)
        except Refusal as refusal:
            return refusals.refused_by_simulation(str(refusal))
        self._read_since = trio.Event()
        with trio.move_on_after(SILENT_S):  # a longer wait means that the link is lost, which ``read`` reports
            await self._read_since.wait()
        self._read_since = None
        return {
            "position": dict(zip(self._config.axes, self._config.position(sample), strict=True)),
            "sim_time_s": sample.time_s,
        }

    def close(self) -> None:
        for control in (self._control, self._beside):
            if control is not None:
                control.close()
        self._control = self._beside = self._observation = None
        self._armed = False

    @property
    def _client(self) -> SimulationClient:
        if self._control is None:
            raise WireDown("the simulation is not connected. Call connect_eagerly() first")
        return self._control

    def _observe(self, sample: p.Sample) -> Observation:
        self._observation = self._observed(sample)
        return self._observation

    def _observed(self, sample: p.Sample) -> Observation:
        config, now_ns = self._config, self._clock.now_ns()
        return Observation(
            t_ns=now_ns,
            position=config.position(sample),
            stamp_ns=(now_ns,) * len(config.units),
            velocity=tuple(
                scale * velocity for velocity, (_, scale) in zip(sample.velocity, config.units, strict=True)
            ),
            sensors={"effort_nm": sample.effort, "sim_time_s": (sample.time_s,), **_of_base(sample)},
            faults=_faults(config.axes, sample.commanders) if self._armed else {},
        )


def _of_base(sample: p.Sample) -> dict[str, tuple[float, ...]]:
    """Return the readings of an inertial sensor on a base that moves freely, by the keys of real robots."""
    if not sample.orientation_wxyz:
        return {}
    return {
        "base_xyz_m": sample.base_xyz_m,
        "orientation_wxyz": sample.orientation_wxyz,
        "rpy_rad": roll_pitch_yaw(sample.orientation_wxyz),
        "gyro_rad_s": sample.gyro_rad_s,
    }


def _faults(axes: Sequence[str], commanders: Sequence[int]) -> dict[str, str]:
    words = {int(Commander.WIRE): HELD_BY_WIRE, int(Commander.NONE): NOT_ENERGISED}
    return {axis: words[commander] for axis, commander in zip(axes, commanders, strict=True) if commander in words}
