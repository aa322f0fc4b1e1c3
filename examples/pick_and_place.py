"""Let a Strands agent pick a cube up and put it down 10 cm to the left, in simulation.

The agent uses two verbs only: ``get_pose`` and ``move_to``. Its model is a fixed script here, so that the example
needs no network and no API key.

pip install 'strands-actors[agent]'
python examples/pick_and_place.py so101
python examples/pick_and_place.py ur5e
"""

import contextlib
import json
import sys
from typing import Any

from strands import Agent
from strands.models import Model

from strands_actors import Robot

LEFT_M, SPEED_M_S = 0.10, 0.6
LIFETIME_S = 1.0
"""Setpoints may be so late, since two simulations can keep a small computer busy."""
DOWN = {"so101": {"rpy": [0, 90, 0]}, "ur5e": {"rpy": [180, 0, 90]}}
"""The orientation with which each tool points down."""
CUBES = {"so101": ([0.22, -0.05, 0.015], 0.03, 0.03), "ur5e": ([-0.49, -0.13, 0.025], 0.05, 0.2)}
"""The cube in the reach of each arm: position and edge in m, mass in kg."""
# The driver of a UR asks the operator before an agent moves it. A simulated one needs no approval.
ARMS: dict[str, dict[str, Any]] = {"so101": {}, "ur5e": {"gripper": "robotiq_2f85", "guarded": ()}}
OPENED = {"so101": 40.0, "ur5e": 100.0}
"""How far each gripper opens, in percent."""
CLOSED = 0.0


@contextlib.contextmanager
def robots(name):
    """Give the robot that an agent needs: the arm with its gripper."""
    with Robot(name, lifetime=LIFETIME_S, **ARMS[name]) as arm:
        place, edge, mass = CUBES[name]
        arm.add_object("cube", "box", position=place, size=[edge, edge, edge], mass=mass)
        yield [arm]


def script_of(name):
    """Return the calls of the agent: tool, and input."""
    (x, y, z), _, _ = CUBES[name]

    def tool_at(left_m, above_m, **how):
        return name, {
            "action": "move_to",
            "xyz": [x, y + left_m, z + above_m],
            **DOWN[name],
            "speed": SPEED_M_S,
            **how,
        }

    def fingers_at(position):
        return name, {"action": "move_to", "targets": {"gripper": position}, "seconds": 1.2}

    return [
        (name, {"action": "get_pose"}),
        fingers_at(OPENED[name]),
        tool_at(0, 0.06, linear=False),
        tool_at(0, 0.005),
        fingers_at(CLOSED),
        tool_at(0, 0.06),
        tool_at(LEFT_M, 0.06),
        # A little higher than it was, so that the cube does not press on the floor.
        tool_at(LEFT_M, 0.01),
        fingers_at(OPENED[name]),
        tool_at(LEFT_M, 0.06),
    ]


class Scripted(Model):
    """A stand-in for a language model. It sends each call of a script, and prints each result."""

    def __init__(self, script):
        self.script = iter(enumerate(script))
        self.failures = []

    def update_config(self, **config):
        pass

    def get_config(self):
        return {}

    def structured_output(self, *_, **__):
        raise NotImplementedError

    async def stream(self, messages, tool_specs=None, system_prompt=None, **_):
        for result in (block["toolResult"] for block in messages[-1]["content"] if "toolResult" in block):
            content = result["content"][0]
            print(f"   {result['status']}: {content.get('text') or summary(content['json'])}")
            if result["status"] != "success":
                self.failures.append(content["text"])
        number, call = next(self.script, (0, None))
        yield {"messageStart": {"role": "assistant"}}
        if call is None or self.failures:
            yield {"contentBlockDelta": {"delta": {"text": "done"}}}
            yield {"contentBlockStop": {}}
            yield {"messageStop": {"stopReason": "end_turn"}}
            return
        tool, inputs = call
        print(tool, json.dumps(inputs))
        yield {"contentBlockStart": {"start": {"toolUse": {"name": tool, "toolUseId": f"use-{number}"}}}}
        yield {"contentBlockDelta": {"delta": {"toolUse": {"input": json.dumps(inputs)}}}}
        yield {"contentBlockStop": {}}
        yield {"messageStop": {"stopReason": "tool_use"}}


def summary(answer):
    """Return the part of a tool's result that the example prints."""
    pose = answer.get("measured_pose", answer)
    return {"xyz": pose["xyz"]} if "xyz" in pose else {"position": answer.get("position")}


def carry(name, tools):
    """Let the agent carry the cube. Return the refusals of its calls."""
    model = Scripted(script_of(name))
    Agent(model=model, tools=tools, callback_handler=None)("Put the cube down 10 cm to the left.")
    return model.failures


if __name__ == "__main__":
    robot = sys.argv[1] if len(sys.argv) > 1 else "so101"
    with robots(robot) as made:
        sys.exit(1 if carry(robot, made) else 0)
