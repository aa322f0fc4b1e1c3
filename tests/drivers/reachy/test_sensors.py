"""Test how long the daemon's values other than positions are valid. The test controls the clock."""

from __future__ import annotations

import json

import trio

from strands_actors.contract.wire import Observation
from strands_actors.drivers.reachy.driver import Reachy
from strands_actors.drivers.reachy.wire import BATTERY_S, ReachyWire
from strands_actors.kernel.clock import NS, MonotonicClock

IMU = {
    "type": "imu_data",
    "accelerometer": [0.0, 0.0, 9.81],
    "gyroscope": [1.0, 2.0, 3.0],
    "quaternion": [1.0, 0.0, 0.0, 0.0],
    "temperature": 30.0,
}
IMU_KEYS = {"accelerometer_m_s2", "gyroscope_rad_s", "quaternion_wxyz", "imu_rpy_rad", "imu_temperature_c"}
UNIT = [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]]


class Clock(MonotonicClock):
    at_ns = 10**12

    def now_ns(self) -> int:
        return self.at_ns


class Told(ReachyWire):
    """A wire that gets the daemon's messages from a test."""

    def __init__(self) -> None:
        self.clock = Clock()
        super().__init__(Reachy("reachy_mini", "192.0.2.1", {}).config, self.clock)

    def tell(self, **frame: object) -> None:
        self._process(json.dumps(frame))

    def later(self, seconds: float) -> Observation:
        """Read after this time, with new positions and a new mode."""
        self.clock.at_ns += round(seconds * NS)
        self.tell(type="joint_positions", head_joint_positions=[0.0] * 7, antennas_joint_positions=[0.0, 0.0])
        self.tell(type="head_pose", head_pose=UNIT)
        self._mode, self._mode_ns = 1.0, self.clock.at_ns
        return trio.run(self.read)


def test_saf_012_a_silent_imu_is_not_in_the_observation() -> None:
    wire = Told()
    wire.tell(**IMU)
    assert wire.later(0.5).sensors.keys() >= IMU_KEYS
    assert not wire.later(0.6).sensors.keys() & IMU_KEYS
    wire.tell(**IMU)
    assert wire.later(0.1).sensors["gyroscope_rad_s"] == (1.0, 2.0, 3.0)


def test_saf_012_a_charge_is_the_newest_and_not_an_old_one() -> None:
    wire = Told()
    assert "battery_pct" not in wire.later(0.1).sensors
    wire.tell(type="daemon_status", state="running", battery_pct=83.0)
    wire.tell(type="daemon_status", state="running", battery_pct=82.0)
    assert wire.later(BATTERY_S - 1).sensors["battery_pct"] == (82.0,)
    assert "battery_pct" not in wire.later(2.0).sensors
    wire.tell(type="daemon_status", state="running", battery_pct=81.0)
    wire.tell(type="daemon_status", state="running")
    assert "battery_pct" not in wire.later(0.1).sensors, "the old charge is not reported any more"
