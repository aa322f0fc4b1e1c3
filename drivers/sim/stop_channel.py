"""Stop a simulation: by its wire, and by the root over its own connection."""

from __future__ import annotations

from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.stop_channels import ConnectWhenNeeded
from strands_actors.contract.wire import MotorReport, WireDown
from strands_actors.drivers.common.kit.outcome import Outcome
from strands_actors.drivers.common.physics.body import Hand
from strands_actors.drivers.common.simulation_control import protocol as p
from strands_actors.drivers.common.simulation_control.client import SimulationClient

from .config import SimConfig
from .gates import HELD_BY_WIRE

SAFE_S = 1.0


class SimStopChannel(ConnectWhenNeeded[SimConfig, SimulationClient]):
    async def connect(self) -> SimulationClient:
        return SimulationClient(self.config.control)

    async def make_safe_by(self, port: SimulationClient, safe_state: SafeState) -> tuple[MotorReport, ...]:
        return await make_safe(self.config, port, safe_state)

    def failed(self, why: str, port: SimulationClient | None = None) -> tuple[MotorReport, ...]:
        return Outcome(False, False, why).reports(self.config.axes, self.config.ids)


async def make_safe(config: SimConfig, control: SimulationClient, safe_state: SafeState) -> tuple[MotorReport, ...]:
    """Make the simulated robot safe. Never raises. The request leaves before anything waits."""
    # Only a robot without power goes limp, and a drone lands. All others stay where they are.
    orders: dict[str, str] = {SafeState.LIMP: p.LIMP, SafeState.OFF: p.LIMP, SafeState.LAND: p.LAND}
    order = orders.get(safe_state, p.HOLD)
    try:
        sample = await control.call(p.Safe(0, order), p.Sample, SAFE_S)
    except WireDown as down:
        return Outcome(False, False, str(down)).reports(config.axes, config.ids)
    wire = int(Hand.WIRE)
    targets = config.position(sample) if safe_state in config.energised else (None,) * len(config.axes)
    return tuple(
        MotorReport(axis, motor, True, True, hand != wire, HELD_BY_WIRE if hand == wire else "", target)
        for axis, motor, hand, target in zip(config.axes, config.ids, sample.hands, targets, strict=True)
    )
