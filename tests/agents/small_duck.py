"""A small robot with two legs and the 14 joints of a Microduck, and a network that makes it walk.

The network is linear. Its outputs for ``head_yaw`` and ``head_roll`` are a clock: each output is the last one,
turned by a small angle, and the input has the last output. The legs follow this clock. The hips shift the weight to
one foot, while the other foot moves forward: a shuffle that needs no balance.

``python -m tests.agents.small_duck FOLDER`` writes ``duck.xml`` and the skill ``walk`` into the folder.
"""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path

from strands_actors.policies.onnx.microduck import ACTIONS, COMMAND, CONTROL_HZ, HOME_RAD, OBSERVATIONS

from .tiny_onnx import linear

JOINTS = tuple(HOME_RAD)
LAST_ACTION = OBSERVATIONS - COMMAND - ACTIONS
TWIST = OBSERVATIONS - COMMAND
STEPS_HZ = 3.0
RADIUS_RAD = 0.15
SHIFT, STRIDE = 1.5, 1.0
"""Amplitudes of the sideways shift and of the stride, as shares of the clock's."""


def model() -> str:
    """Return the robot as MJCF. It stands at the home pose of a Microduck, on wide feet."""

    def joint(name: str, axis: str) -> str:
        place = f'name="{name}" axis="{axis}" ref="{HOME_RAD[name]}"'
        return f'<joint {place} range="-3 3" damping=".02" armature=".001"/>'

    def mass(kg: float, size: str, at: str = "0 0 0", touches: int = 0) -> str:
        return (
            f'<geom type="box" size="{size}" pos="{at}" mass="{kg}" contype="{touches}" conaffinity="{touches}"/>'
        )

    def leg(side: str, y: float) -> str:
        return f"""
        <body pos="0 {y} 0">{joint(f"{side}_hip_yaw", "0 0 1")}{mass(0.02, ".01 .01 .01")}
         <body>{joint(f"{side}_hip_roll", "1 0 0")}{mass(0.02, ".01 .01 .01")}
          <body>{joint(f"{side}_hip_pitch", "0 1 0")}{mass(0.02, ".008 .008 .025", "0 0 -.025")}
           <body pos="0 0 -.05">{joint(f"{side}_knee", "0 1 0")}{mass(0.02, ".008 .008 .02", "0 0 -.02")}
            <body pos="0 0 -.04">{joint(f"{side}_ankle", "0 1 0")}{mass(0.04, ".05 .028 .005", "0 0 -.005", 1)}
        </body></body></body></body></body>"""

    names = "".join(f'<position joint="{name}" kp="10" kv=".2"/>' for name in JOINTS)
    return f"""<mujoco><compiler angle="radian"/>
      <worldbody>
       <geom type="plane" size="0 0 .1" friction=".8"/>
       <body name="trunk" pos="0 0 .1"><freejoint/>{mass(0.25, ".03 .03 .02", "0 0 .03")}
        {leg("left", 0.03)}{leg("right", -0.03)}
        <body pos="0 0 .06">{joint("neck_pitch", "0 1 0")}{mass(0.005, ".01 .01 .01")}
         <body>{joint("head_pitch", "0 1 0")}{mass(0.005, ".01 .01 .01")}
          <body>{joint("head_yaw", "0 0 1")}{mass(0.005, ".01 .01 .01")}
           <body>{joint("head_roll", "1 0 0")}{mass(0.005, ".01 .01 .01")}
        </body></body></body></body>
       </body>
      </worldbody>
      <actuator>{names}</actuator>
    </mujoco>"""


def network(shift: float = SHIFT, stride: float = STRIDE, hz: float = STEPS_HZ) -> bytes:
    """Return a network of 61 inputs and 14 outputs that makes the robot walk forward."""
    turn = math.tau * hz / CONTROL_HZ
    cos, sin = math.cos(turn), math.sin(turn)
    yaw, roll = JOINTS.index("head_yaw"), JOINTS.index("head_roll")
    rows = [[0.0] * ACTIONS for _ in range(OBSERVATIONS)]
    bias = [0.0] * ACTIONS
    last_yaw, last_roll = rows[LAST_ACTION + yaw], rows[LAST_ACTION + roll]
    last_yaw[yaw], last_yaw[roll] = cos, sin
    last_roll[yaw], last_roll[roll] = -sin, cos
    # From zero, the clock turns around the point ``center`` at this radius.
    center = (RADIUS_RAD, 0.0)
    bias[yaw] = center[0] - (cos * center[0] - sin * center[1])
    bias[roll] = center[1] - (sin * center[0] + cos * center[1])
    for side, sign in (("left", 1.0), ("right", -1.0)):
        hip, ankle, sway = (JOINTS.index(f"{side}_{part}") for part in ("hip_pitch", "ankle", "hip_roll"))
        last_roll[hip] = sign * stride
        last_roll[ankle] = -sign * stride
        last_yaw[sway] = shift
        bias[sway] = -shift * center[0]
    return linear(rows, bias)


def write(folder: Path) -> tuple[Path, Path]:
    """Write the model and the skill, with a manifest of schema 2. Return the file of the model and the folder."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "duck.xml").write_text(model())
    skill = folder / "walk"
    skill.mkdir(exist_ok=True)
    (skill / "walk.onnx").write_bytes(network())
    robot = {"model": "microduck", "control_hz": CONTROL_HZ}
    sizes = {"obs_len": OBSERVATIONS, "action_len": ACTIONS, "model_api": 1}
    claims = {"schema": 2, "name": "walk", "file": "walk.onnx", "kind": "perpetual", "robot": robot, **sizes}
    (skill / "manifest.json").write_text(json.dumps(claims))
    return folder / "duck.xml", skill


if __name__ == "__main__":
    print(*write(Path(sys.argv[1])))
