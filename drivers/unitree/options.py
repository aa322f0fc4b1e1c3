"""Constructor keywords of Unitree's robots, for ``level="low"`` (joints) and ``level="sport"`` (walking)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Literal

from msgspec import Meta

from strands_actors.contract.driver import Service
from strands_actors.contract.options import DriverOptions, option
from strands_actors.drivers.common.ports.network_interfaces import NetworkInterface

from .gates import BATTERY_FLOOR_PCT
from .rpc import ATTEMPTS, RELEASE_S


class LegsOptions(DriverOptions, frozen=True):
    level: Annotated[
        Literal["low", "sport"],
        option(
            "what commands the joints. low: this program, 500 times a second. sport: the robot's own controller, "
            "which walks, and takes velocities and postures"
        ),
    ] = "low"
    on_exit: Annotated[
        Literal["zero_torque", "damp"],
        option("what ends every motion; damp: half a second of braking before zero torque"),
    ] = "zero_torque"
    battery_floor_pct: Annotated[
        float, option("charge under which nothing is commanded, 0 to 100 percent", ge=0, le=100)
    ] = BATTERY_FLOOR_PCT
    domain: Annotated[
        Annotated[int, Meta(ge=0, le=232)] | None,
        option("DDS domain, 0 to 232; None: 0, which robots speak in, or 1 of a simulator"),
    ] = None
    simulator: Annotated[
        bool,
        option(
            "True or False: whether it is Unitree's own simulator, unitree_mujoco. It has no mode and no FSM "
            "that could be asked, and its states may come without checksum and without a tick that goes on: never "
            "of a robot. On this host its port is 127.0.0.1"
        ),
    ] = False
    network_interface: NetworkInterface = ""


IMU: Mapping[str, str] = {
    "rpy": "rpy_rad",
    "gyro": "gyro_rad_s",
    "accel": "acceleration_m_s2",
    "quaternion": "orientation_wxyz",
}
"""Field of the IMU in an observation -> name of the sensor."""

OF_JOINTS: Mapping[str, Service] = {
    "release_sport_mode": Service(
        "end the robot's own controller, so that its joints can be commanded: it no longer balances by itself",
        within_s=ATTEMPTS * RELEASE_S + 1.0,
        arguments={"attempts": ATTEMPTS},
        counts={"attempts": ATTEMPTS},
        powers=True,
        releases=True,
        late_s=RELEASE_S,
    )
}
"""Services of a robot whose joints are commanded."""
