"""Let a Strands agent move a simulated SO-101 arm.

The agent's model is a fixed script here, so that the example needs no network and no API key. Replace
``Scripted`` by a real model to use it with your own prompts.

pip install 'strands-actors[agent]'
python examples/agent.py
"""

import json

from strands import Agent
from strands.models import Model

from strands_actors import Robot

SCRIPT = [
    # The robot refuses 400 degrees, which is beyond the joint's range.
    {"action": "move_to", "targets": {"shoulder_pan": 400.0}},
    {"action": "move_to", "targets": {"shoulder_pan": 20.0}},
    # This action energises the robot, so it needs the operator's approval, and the operator refuses.
    {"action": "set_torque", "enabled": True},
    {"action": "stop"},  # A stop needs no approval.
]


class Scripted(Model):
    """A stand-in for a language model. It sends each line of a script to the tool, and prints each result."""

    def __init__(self, script):
        self.script = iter(enumerate(script))

    def update_config(self, **config):
        pass

    def get_config(self):
        return {}

    def structured_output(self, *_, **__):
        raise NotImplementedError

    async def stream(self, messages, tool_specs=None, system_prompt=None, **_):
        # Print the result of the previous tool call.
        for block in messages[-1]["content"]:
            if "toolResult" in block:
                content = block["toolResult"]["content"][0]
                print(f"   {block['toolResult']['status']}: {content.get('text') or summary(content['json'])}")
        # Stream the next tool call as Strands events. At the end of the script, stream a text instead.
        yield {"messageStart": {"role": "assistant"}}
        number, line = next(self.script, (0, None))
        if line is None:
            yield {"contentBlockDelta": {"delta": {"text": "done"}}}
            yield {"contentBlockStop": {}}
            yield {"messageStop": {"stopReason": "end_turn"}}
            return
        print("so101", json.dumps(line))
        yield {"contentBlockStart": {"start": {"toolUse": {"name": "so101", "toolUseId": f"use-{number}"}}}}
        yield {"contentBlockDelta": {"delta": {"toolUse": {"input": json.dumps(line)}}}}
        yield {"contentBlockStop": {}}
        yield {"messageStop": {"stopReason": "tool_use"}}


def summary(answer):
    """Return the parts of a tool's result that the example prints."""
    return {key: answer[key] for key in ("commanded", "stopped", "safe_state", "unconfirmed") if key in answer}


def approve(request):
    """Ask the operator to approve a request. In this example the operator always refuses."""
    print(f"   operator: {request}? no")
    return False


# The robot is a tool of the agent. Actions that need an approval run only if ``approve`` returns True.
with Robot("so101", mode="real", transport="twin", approve=approve) as arm:
    Agent(model=Scripted(SCRIPT), tools=[arm], callback_handler=None)("wave at me")
