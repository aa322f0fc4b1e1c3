"""Describe the devices of the simulated robot, as its service answers the vendor's requests for them.

The vendor's client reads a number, the kind, and a body of any form. The numbers are those of the vendor's enum.
The body of the sensors has the fields of the vendor's classes ``ImuInfoList`` and ``ImuInfo``. The bodies of the
hands and of the robot's model are [assumed].
"""

from __future__ import annotations

from typing import Any

from strands_actors.drivers.booster.robots import Model
from strands_actors.drivers.booster.rpc import Api

_KINDS = {Api.GET_SENSORS: 0, Api.GET_HANDS: 1, Api.GET_ROBOT_MODEL: 2}
UNKNOWN_IMU = 0
"""Number of an inertial unit without a known type, in the vendor's enum ``ImuModel``."""


def device_info(model: Model, api: int) -> dict[str, Any]:
    """Return the answer to a request for devices.

    Args:
        model: The robot type.
        api: ``GET_SENSORS``, ``GET_HANDS`` or ``GET_ROBOT_MODEL``.
    """
    bodies: dict[Api, dict[str, Any]] = {
        Api.GET_SENSORS: {
            "imus": [{"index": 0, "name": "imu", "model": UNKNOWN_IMU, "mount_position": "base"}],
        },
        Api.GET_HANDS: {"hands": []},
        Api.GET_ROBOT_MODEL: {"name": model.name, "joints": [motor.key for motor in model.motors]},
    }
    kind = Api(api)
    return {"kind": _KINDS[kind], "body": bodies[kind]}
