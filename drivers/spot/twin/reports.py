"""What the simulated Spot reports: its state, its frames, and its hardware."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

from strands_actors.drivers.spot import protocol as p
from strands_actors.drivers.spot.messages import Message
from strands_actors.drivers.spot.protocol import Motors
from strands_actors.drivers.spot.robots import LEGS, wire_name

from .faults import RobotFaults
from .frames import frames_of
from .geometry import Pose
from .limbs import foot_at
from .mechanism import JOINTS, Mechanism
from .safety import Estop

STOWED, DEPLOYED = 1, 2
"""Values of ``stow_state``."""
NOT_READY, TRANSITION, STANDING, STEPPING = 1, 2, 3, 4
"""Values of ``behavior_state``."""
NOT_CARRIABLE = 1
CONTACT_MADE = 1
OFF_SHORE_POWER, PARTS_ON, DISCHARGING = 2, 1, 3
HARDWARE, SOFTWARE, PRESSED, RELEASED = 1, 2, 1, 2
"""Type and state of an e-stop."""

IDENTITY: Mapping[str, Any] = {
    "serial_number": "spot-twin",
    "species": "spot",
    "version": "V3",
    "nickname": "twin",
    "software_release": {"version": {"major_version": 5, "minor_version": 2, "patch_level": 0}},
}

NO_FRAMES: Mapping[str, tuple[str, Pose]] = {}
_LEG_LINKS = ("hip", "uleg", "lleg")
_ARM_LINKS = ("sh0", "sh1", "el0", "el1", "wr0", "wr1", "fngr")


class Reports:
    """The robot-state service.

    Args:
        mechanism: The body.
        has_arm: True if the robot has an arm.
        estop: Returns the e-stop.
        robot_ns: The robot's clock.
        faults: The active faults.
        table: The robot's row in ``robots.toml``.
    """

    def __init__(
        self,
        mechanism: Mechanism,
        has_arm: bool,
        estop: Callable[[], Estop],
        robot_ns: Callable[[], int],
        faults: RobotFaults,
        table: Mapping[str, Any],
    ) -> None:
        self._mechanism = mechanism
        self._has_arm = has_arm
        self._estop = estop
        self._robot_ns = robot_ns
        self._faults = faults
        self._table = table

    def state(self, wrong_m_s: float = 0.0) -> Message:
        """Return the robot's present state.

        Args:
            wrong_m_s: Error of the reported speed. A fault of the twin.
        """
        mechanism, stamp = self._mechanism, p.stamp(self._robot_ns())
        return {
            "power_state": {
                "timestamp": stamp,
                "motor_power_state": int(mechanism.motors),
                "shore_power_state": OFF_SHORE_POWER,
                "robot_power_state": PARTS_ON,
            },
            "battery_states": [
                {
                    "identifier": "twin",
                    "charge_percentage": {"value": 77.0},
                    "voltage": {"value": 55.0},
                    "status": DISCHARGING,
                }
            ],
            "estop_states": self._estops(),
            "kinematic_state": {
                "acquisition_timestamp": stamp,
                "joint_states": self.joints(),
                **self._velocities(wrong_m_s),
                "transforms_snapshot": self.frame_tree(),
            },
            **self._faults.report(),
            "foot_state": self._feet(),
            "behavior_state": {"state": self._behaviour()},
            **({"manipulator_state": self._arm()} if self._has_arm else {}),
        }

    def metrics(self) -> Message:
        """Return the metrics since the start. Their labels are [assumed]."""
        mechanism = self._mechanism
        return {
            "timestamp": p.stamp(self._robot_ns()),
            "metrics": [
                {"label": "distance", "units": "m", "float_value": mechanism.walked_m},
                {"label": "time moving", "duration": p.duration(mechanism.walked_s)},
                {"label": "electric power", "duration": p.duration(mechanism.powered_s)},
            ],
        }

    def hardware(self) -> Message:
        """Return the hardware configuration. It has the names of the links, but no URDF [assumed]."""
        links = ["body", *(f"{leg}.{link}" for leg in ("fl", "fr", "hl", "hr") for link in _LEG_LINKS)]
        if self._has_arm:
            links += [f"arm0.link_{link}" for link in _ARM_LINKS]
        return {
            "skeleton": {"links": [{"name": name} for name in links], "urdf": ""},
            "can_power_command_request_off_robot": False,
            "can_power_command_request_cycle_robot": False,
            "can_power_command_request_payload_ports": False,
            "can_power_command_request_wifi_radio": False,
        }

    def link(self, name: str) -> Message:
        """Return the model of a link. "To limit the size, the contents might be omitted" (robot_state.proto)."""
        has_link = any(link["name"] == name for link in self.hardware()["skeleton"]["links"])
        return {"file_name": f"{name}.obj"} if has_link else {}

    def joints(self) -> list[Message]:
        mechanism = self._mechanism
        legs = [angle for leg in mechanism.legs_rad for angle in leg]
        joints = {wire_name(key): (angle, 0.0) for key, angle in zip(LEGS, legs, strict=True)}
        if self._has_arm:
            both = zip(JOINTS, mechanism.joints, mechanism.speeds, strict=True)
            joints |= {wire_name(key): (position, speed) for key, position, speed in both}
        return [
            {"name": name, "position": {"value": position}, "velocity": {"value": speed}}
            for name, (position, speed) in joints.items()
        ]

    def _estops(self) -> list[Message]:
        estop = self._estop()
        is_released = estop.level is p.StopLevel.NONE
        return [
            {"name": "hardware_estop", "type": HARDWARE, "state": PRESSED if estop.pressed else RELEASED},
            {"name": "software_estop", "type": SOFTWARE, "state": RELEASED if is_released else PRESSED},
        ]

    def _velocities(self, wrong_m_s: float) -> Message:
        mechanism = self._mechanism
        vx, vy, vz, wz = mechanism.velocity
        yaw = mechanism.yaw_rad
        linear = {"x": vx + wrong_m_s * math.cos(yaw), "y": vy + wrong_m_s * math.sin(yaw), "z": vz}
        speed = {"linear": linear, "angular": {"z": wz}}
        return {"velocity_of_body_in_vision": speed, "velocity_of_body_in_odom": speed}

    def frame_tree(self, more: Mapping[str, tuple[str, Pose]] = NO_FRAMES) -> Message:
        """Return the message ``FrameTreeSnapshot``. Its root is the body.

        Args:
            more: Further frames by name: the name of the parent, and the pose in the parent.
        """
        poses = frames_of(self._mechanism, self._has_arm)
        edges: dict[str, tuple[str, Pose]] = {"body": ("", Pose())}
        for name, pose in poses.items():
            if name != "body":
                parent = "odom" if name == "gpe" else "body"
                edges[name] = parent, poses[parent].inverse().compose(pose)
        return {
            "edges": [
                {"key": name, "value": {"parent_frame_name": parent, "parent_tform_child": pose.as_message()}}
                for name, (parent, pose) in {**edges, **more}.items()
            ]
        }

    def _feet(self) -> list[Message]:
        feet = (foot_at(leg, angles) for leg, angles in enumerate(self._mechanism.legs_rad))
        return [
            {"foot_position_rt_body": dict(zip("xyz", foot, strict=True)), "contact": CONTACT_MADE} for foot in feet
        ]

    def _behaviour(self) -> int:
        mechanism = self._mechanism
        if mechanism.motors is not Motors.ON or (mechanism.up == 0.0 and not mechanism.wants_up):
            return NOT_READY
        if not mechanism.stands or not mechanism.wants_up:
            return TRANSITION
        return STEPPING if mechanism.walks else STANDING

    def _arm(self) -> Message:
        """Return the state of arm and gripper. The claw opens towards its lower limit."""
        *arm, claw = self._mechanism.joints
        *home, _ = self._table["home_rad"]
        open_rad = next(reversed(self._table["joints_rad"].values()))[0]
        return {
            "is_gripper_holding_item": False,
            "stow_state": STOWED if arm == home else DEPLOYED,
            "gripper_open_percentage": 100.0 * claw / open_rad,
            "carry_state": NOT_CARRIABLE,
        }
