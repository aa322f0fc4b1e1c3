"""The limits on commands to a robot that is a node of a ROS 2 graph. Pure."""

from __future__ import annotations

from collections.abc import Sequence

from strands_actors.contract.axis import Axis
from strands_actors.contract.axis_gates import axis_gates
from strands_actors.contract.driver import Candidate, GateCheck, GateState
from strands_actors.drivers.common.kit.step_gates import refuse_lead
from strands_actors.kernel.messages import Refused

LEAD_S = 0.5
"""A joint may have this far to go, at its greatest speed. If all processes of this package end at once, the node
carries out the last goal, and so no more than this."""


def all_gates(axes: Sequence[Axis], state_ttl_s: float) -> tuple[GateCheck, ...]:
    """Return the gates in the order in which they are called."""
    speeds = [axis.speed for axis in axes]

    def lead(candidate: Candidate, state: GateState) -> Refused | None:
        return refuse_lead(axes, candidate, state, speeds, LEAD_S)

    return (*axis_gates(axes, state_ttl_s, oneshot_s=LEAD_S), lead)
