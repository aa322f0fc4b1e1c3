"""The state of a Unitree robot that is needed both to command its joints and to walk.

It consists of the LowState, the battery's charge, and the onboard mode that controls the motors.
"""

from __future__ import annotations

from contextlib import suppress

from strands_actors.contract.rotations import roll_pitch_yaw
from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.kernel.clock import NS, Clock

from . import protocol as p
from . import rpc
from .link import Network, Service
from .protocol import State

ASK_EVERY_NS = 100_000_000
"""Period of asking the robot for its onboard mode and its FSM id."""


class RobotSession:
    """One connection to the robot, from ``open`` to ``close``, with the newest state."""

    def __init__(self, network: Network, clock: Clock) -> None:
        self.network = network
        self.clock = clock
        self.modes = Service(network.participant, rpc.MOTION_SWITCHER, clock)
        if network.model.family == "hg":
            network.participant.reader(p.BATTERY_TOPIC, p.BATTERY_TYPE, self._on_battery)
        self.mode: tuple[str, float] | None = None  # Name of the onboard mode, and the time of the request in s.
        self.battery: tuple[float, float] | None = None

    def ask_mode(self) -> None:
        self.modes.ask(rpc.CHECK_MODE, self.on_mode)

    def on_mode(self, response: rpc.Response) -> None:
        if not response.error:
            self.mode = rpc.mode_name(response), response.id / NS

    def sensors_of(self, state: State) -> dict[str, tuple[float, ...]]:
        """Return the sensor values of a LowState (except the joint positions) and the battery's charge."""
        sensors: dict[str, tuple[float, ...]] = {
            "torque_nm": state.tau,
            "temperature_c": state.temperature,
            "orientation_wxyz": state.quaternion,
            "rpy_rad": roll_pitch_yaw(state.quaternion),
            "gyro_rad_s": state.gyroscope,
            "acceleration_m_s2": state.accelerometer,
            "mode_machine": (state.machine,),
        }
        discarded = self.network.discarded
        if discarded:
            sensors["discarded_states"] = (float(discarded.total()),)
        if state.soc is not None:  # Otherwise keep the last charge. The gates refuse it once it is too old.
            self.battery = float(state.soc), self.network.state_ns / NS
        if self.battery is not None:
            sensors["battery_pct"], sensors["battery_stamp_s"] = self.battery[:1], self.battery[1:]
        return sensors

    def _on_battery(self, payload: memoryview, writer: bytes, t_ns: int) -> None:
        with suppress(MalformedFrame):  # Ignore an unreadable charge. The gates refuse an old or unknown charge.
            self.battery = float(p.decode_battery(payload[4:])), t_ns / NS
