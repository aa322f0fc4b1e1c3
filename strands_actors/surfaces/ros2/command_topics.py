"""The topics and actions with which the graph moves one robot."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Mapping
from typing import Any

from strands_actors.kernel.channels.ros2.definitions import JOINT_STATE, NUMBERS, TRAJECTORY, TWIST, TWIST_STAMPED
from strands_actors.kernel.channels.ros2.graph import Arrival, Node
from strands_actors.kernel.channels.ros2.names import ros_name
from strands_actors.kernel.messages import Refused

from .action import GripperAction, TrajectoryAction, TrajectoryTopic
from .commands import Targets, targets_of_joints, targets_of_numbers, targets_of_twist
from .joints import Layout
from .motion import Mover
from .writer import Writer, is_at_rest

Task = Callable[[], Awaitable[None]]
Convert = Callable[[str, Mapping[str, Any], Layout], Targets | Refused]


class CommandTopics:
    """What moves one robot. Run each of ``tasks`` in the background.

    Args:
        node: The node of the robot.
        prefix: What stands before the names of its topics.
        layout: Its joints and its base.
        writer: Sends the commands of streams to the robot.
        mover: Moves the robot along planned paths.
        publisher_of: Returns the name of a message's publisher, from its topic and the message.
        report: Called with each refusal.
        log: Called with each line for the user.
    """

    def __init__(
        self,
        node: Node,
        prefix: str,
        layout: Layout,
        writer: Writer,
        mover: Mover,
        publisher_of: Callable[[str, Arrival], str],
        report: Callable[[Refused], None],
        log: Callable[[str], None],
    ) -> None:
        self.tasks: list[Task] = [writer.run]
        self._node = node
        self._prefix = prefix
        self._layout = layout
        self._writer = writer
        self._publisher_of = publisher_of
        if layout.commanded:
            action = TrajectoryAction(node, f"{prefix}/follow_joint_trajectory", layout, mover, log)
            self.tasks.append(action.run)
            self._take_trajectories(mover, report)
            self._take("joint_command", JOINT_STATE, targets_of_joints)
            self._take("joint_command", NUMBERS, targets_of_numbers)
        for gripper in layout.grippers:
            own = "gripper_cmd" if len(layout.grippers) == 1 else f"{ros_name(gripper.joint.key)}_cmd"
            self.tasks.append(GripperAction(node, f"{prefix}/{own}", gripper, mover, log).run)
        if layout.twist:
            self._take("cmd_vel", TWIST, targets_of_twist, at_rest=True)
            self._take("cmd_vel", TWIST_STAMPED, _targets_of_twist_stamped, at_rest=True)

    def _take(self, name: str, type_name: str, convert: Convert, at_rest: bool = False) -> None:
        """Send the messages of a topic to the robot. With ``at_rest`` a message of zeros ends a stream."""
        topic, layout, writer = f"{self._prefix}/{name}", self._layout, self._writer

        def on_message(arrival: Arrival) -> None:
            targets = convert(topic, arrival.message, layout)
            writer.offer(
                topic, arrival, self._publisher_of(topic, arrival), targets, at_rest and is_at_rest(targets)
            )

        self._node.subscribe(topic, type_name, on_message)

    def _take_trajectories(self, mover: Mover, report: Callable[[Refused], None]) -> None:
        topic = f"{self._prefix}/joint_trajectory"
        trajectories = TrajectoryTopic(topic, self._layout, mover, report)
        self.tasks.append(trajectories.run)

        def on_trajectory(arrival: Arrival) -> None:
            trajectories.on_message(arrival, self._publisher_of(topic, arrival))

        self._node.subscribe(topic, TRAJECTORY, on_trajectory)


def _targets_of_twist_stamped(topic: str, message: Mapping[str, Any], layout: Layout) -> Targets | Refused:
    return targets_of_twist(topic, message["twist"], layout)
