"""The requests to the robot's service, and the topics, that the simulated robot models."""

from __future__ import annotations

from strands_actors.drivers.booster import rpc
from strands_actors.drivers.booster.rpc import Api
from strands_actors.drivers.common.twin.modelled import Modelled

REQUESTS: Modelled[int] = Modelled(
    "requests to its service",
    {
        Api.CHANGE_MODE: "changes the mode; status 502 after a fall, except to damping",
        Api.MOVE: "walks; status 502 in a mode that does not walk",
        Api.ROTATE_HEAD: "turns the head; status 502 in a mode without balance",
        Api.GET_UP: "gets up after a fall; otherwise status 409",
        Api.GET_FRAME_TRANSFORM: "returns the pose of one of six frames in another one; status 400 for others",
        Api.GET_MODE: "returns the mode",
        Api.GET_STATUS: "returns the mode; the lists of actions are empty",
        Api.GET_ROBOT_INFO: "returns the name",
        Api.UPPER_BODY: "hands the upper body over to rt/joint_ctrl, or takes it back",
        Api.RESET_ODOMETRY: "sets the odometry to the given pose, or to zero without one",
        Api.GET_SENSORS: "returns the inertial unit of the model",
        Api.GET_HANDS: "returns an empty list, because the model has no hands",
        Api.GET_ROBOT_MODEL: "returns the links and joints of the model",
    },
    f"status {rpc.REFUSED}, refused",
)

TOPICS: Modelled[str] = Modelled(
    "topics that it subscribes to",
    {"rt/joint_ctrl": "commands the arms, after the hand-over; all joints in the mode custom"},
    "silence: no other topic has a reader",
)
