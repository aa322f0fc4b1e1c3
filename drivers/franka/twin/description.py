"""Build the description of an arm that a controller sends: a URDF (FCI 10)."""

from __future__ import annotations

import math

from strands_actors.drivers.franka.arms import FLANGE_M, JOINTS, LINKS, Arm


def urdf(arm: Arm) -> str:
    """Return the arm as a URDF. Its joints have the limits that libfranka reads, and the names of links and joints
    end in the numbers that it requires."""
    parts = [f'<robot name="{arm.joints.removesuffix("joint").strip("_") or "fer"}">', '<link name="link0"/>']
    for index, key in enumerate(arm.keys):
        place, degrees = LINKS[index]
        offset, slope, _, _ = arm.ends[index] if arm.ends else (0.0, 100.0, 0.0, 0.0)
        parts += [
            _link(f"link{index + 1}", arm.link_kg[index], arm.com[index]),
            f'<joint name="{key}" type="revolute"><origin xyz="{_row(place)}" rpy="{math.radians(degrees)} 0 0"/>',
            f'<parent link="link{index}"/><child link="link{index + 1}"/><axis xyz="0 0 1"/>',
            f'<limit lower="{arm.low[index]}" upper="{arm.high[index]}" velocity="{arm.speed[index]}" '
            f'effort="{arm.effort[index]}"/>',
            f'<position_based_velocity_limits velocity_offset="{offset}" deceleration_limit="{slope / 2}"/>',
            "</joint>",
        ]
    flange = JOINTS + 1
    parts += [
        _link(f"link{flange}", 0.01, (0.0, 0.0, 0.0)),
        f'<joint name="{arm.joints}{flange}" type="fixed"><origin xyz="0 0 {FLANGE_M}" rpy="0 0 0"/>',
        f'<parent link="link{JOINTS}"/><child link="link{flange}"/></joint>',
        "</robot>",
    ]
    return "".join(parts)


def _link(name: str, kg: float, com: tuple[float, float, float]) -> str:
    inertia = kg * 0.1**2 / 12  # The real inertia is not published: [assumed].
    return (
        f'<link name="{name}"><inertial><origin xyz="{_row(com)}" rpy="0 0 0"/><mass value="{kg}"/>'
        f'<inertia ixx="{inertia}" ixy="0" ixz="0" iyy="{inertia}" iyz="0" izz="{inertia}"/></inertial></link>'
    )


def _row(numbers: tuple[float, ...]) -> str:
    return " ".join(str(number) for number in numbers)
