"""Stop a simulated robot, from its wire process and from the root process over a separate connection."""

from __future__ import annotations

from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.stop_channels import ConnectWhenNeeded
from strands_actors.contract.wire import MotorReport, WireDown
from strands_actors.drivers.common.kit.outcome import Outcome
from strands_actors.drivers.common.physics.body import Commander
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

    def failed(self, reason: str, port: SimulationClient | None = None) -> tuple[MotorReport, ...]:
        return Outcome(False, False, reason).reports(self.config.axes, self.config.ids)


async def make_safe(config: SimConfig, control: SimulationClient, safe_state: SafeState) -> tuple[MotorReport, ...]:
    """Make the simulated robot safe. Never raises. The request is sent before the first wait."""
    # Only LIMP and OFF make the joints limp, as in a robot without power. LAND lands a drone. For all other safe
    # states the robot stays where it is.
    orders: dict[str, str] = {SafeState.LIMP: p.LIMP, SafeState.OFF: p.LIMP, SafeState.LAND: p.LAND}
    order = orders.get(safe_state, p.HOLD)
    try:
        sample = await control.call(p.Safe(0, order), p.Sample, SAFE_S)
    except WireDown as down:
        return Outcome(False, False, str(down)).reports(config.axes, config.ids)
    wire = int(Commander.WIRE)
    targets = config.position(sample) if safe_state in config.energised else (None,) * len(config.axes)
    return tuple(
        MotorReport(axis, motor, True, True, commander != wire, HELD_BY_WIRE if commander == wire else "", target)
        for axis, motor, commander, target in zip(config.axes, config.ids, sample.commanders, targets, strict=True)
    )
