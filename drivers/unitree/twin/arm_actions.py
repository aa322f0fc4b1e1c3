"""Simulate the service ``arm`` of a G1: gestures such as "clap", which the robot knows by a number.

As on the robot, the gestures command the arms as a client of ``rt/arm_sdk`` does. Requests, numbers, names and
errors are those of the vendor's SDK. Its example calls release (99) after some gestures. These (``holds``) keep
their last pose until release, until the same number comes again, or for 20 s. The service answers at the end of a
gesture [assumed: the vendor's example waits up to 10 s, and says that every gesture is shorter]. The poses and
times are [assumed].

This module has no clock and no physics.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from strands_actors.drivers.unitree import rpc
from strands_actors.drivers.unitree.gates import HANDSHAKE_FSM
from strands_actors.drivers.unitree.robots import Model
from strands_actors.drivers.unitree.rpc import Request, Response

from .arm_sdk import ArmSdk

SERVICE, VERSION = "arm", "1.0.0.14"
EXECUTE, LIST = 7106, 7107
OCCUPIED, HOLDING, NO_SUCH_ACTION, WRONG_FSM = 7400, 7401, 7402, 7404
STATE_TOPIC, STATE_TYPE = "rt/arm/action/state", "std_msgs::msg::dds_::String_"

RELEASE = 99
REACH_S, SWING_S, RETURN_S = 2.0, 2.0, 2.0
"""Times of a gesture. With faster arms the simulated robot, which does not balance, falls over."""
HOLD_S = 20.0
"""Longest time for which a pose is held, from the vendor's SDK."""
KP, KD = 60.0, 1.5
"""Gains of the vendor's examples for ``rt/arm_sdk``."""


class Gesture(NamedTuple):
    name: str
    arms: str
    """``l``, ``r`` or ``lr``."""
    pose: tuple[float, float, float, float]
    """Shoulder pitch, roll and yaw, and elbow of the left arm, rad. Roll and yaw of the right arm are opposite."""
    swing_rad: float = 0.0
    """The shoulder's yaw swings so far around the pose."""
    holds: bool = False


GESTURES = {
    11: Gesture("two_hand_kiss", "lr", (-1.2, 0.2, -0.3, 0.2)),
    12: Gesture("left_kiss", "l", (-1.2, 0.2, -0.3, 0.2)),
    13: Gesture("right_kiss", "r", (-1.2, 0.2, -0.3, 0.2)),
    15: Gesture("hands_up", "lr", (-2.6, 0.3, 0.0, 1.2), holds=True),
    17: Gesture("clap", "lr", (-0.8, 0.2, 0.0, 0.6), 0.3),
    18: Gesture("high_five", "r", (-1.8, 0.2, 0.0, 0.6), holds=True),
    19: Gesture("hug", "lr", (-1.0, 0.6, -0.6, 0.6), holds=True),
    20: Gesture("heart", "lr", (-2.6, 0.5, -0.6, 0.2), holds=True),
    21: Gesture("right_heart", "r", (-2.6, 0.5, -0.6, 0.2), holds=True),
    22: Gesture("reject", "lr", (-0.9, 0.1, -0.8, 0.4), holds=True),
    23: Gesture("right_hand_up", "r", (-2.6, 0.3, 0.0, 1.2), holds=True),
    24: Gesture("x_ray", "lr", (-1.0, 0.3, 0.9, 0.0), holds=True),
    25: Gesture("face_wave", "r", (-1.0, 0.3, 0.3, -0.2), 0.4),
    26: Gesture("high_wave", "r", (-2.4, 0.4, 0.3, 0.6), 0.4),
    27: Gesture("shake_hand", "r", (-0.6, 0.0, 0.0, 0.6), holds=True),
}
_JOINTS = ("shoulder_pitch", "shoulder_roll", "shoulder_yaw", "elbow")
_MIRROR = (1.0, -1.0, -1.0, 1.0)
_YAW = 2


def _smooth(share: float) -> float:
    """Return the share of a way, 0 to 1, that begins and ends without a jerk."""
    return share * share * (3.0 - 2.0 * share)


class _Run(NamedTuple):
    """One gesture that the arms make now."""

    action: int
    began_s: float
    start: Sequence[float]
    """Positions of all joints at its beginning. The arms return to them."""
    request: Request | None
    """The request to answer, or None once it was answered."""
    returns_s: float = math.inf
    """Time at which the arms begin to return."""
    end: Sequence[float] = ()
    """Positions of all joints at this time."""


class ArmActions:
    """The service. Finished gestures put their responses into ``responses``."""

    def __init__(self, model: Model, arms: ArmSdk, position: Callable[[], Sequence[float]]) -> None:
        """Make the service.

        Args:
            model: The robot.
            arms: Receives the commands of the gestures.
            position: Returns the present positions of all joints, rad.
        """
        self.responses: list[Response] = []
        self._axes = model.axes
        self._arms = arms
        self._position = position
        self._run: _Run | None = None

    def reset(self) -> None:
        """Forget the gesture and its request, as after a boot."""
        self._run = None
        self.responses.clear()

    @property
    def state(self) -> dict[str, Any]:
        """The content of the topic ``rt/arm/action/state``."""
        run = self._run
        if run is None:
            return {"holding": False, "id": 0, "name": ""}
        if run.returns_s < math.inf:
            return {"holding": False, "id": RELEASE, "name": "release_arm"}
        return {"holding": self._holds(run), "id": run.action, "name": GESTURES[run.action].name}

    @staticmethod
    def _holds(run: _Run) -> bool:
        return run.request is None and GESTURES[run.action].holds and run.returns_s == math.inf

    def order(
        self, request: Request, parameter: dict[str, Any], now_s: float, fsm: int | None
    ) -> tuple[int, Any] | None:
        """Handle a request. Return the code and the data of the answer, or None if it is answered later.

        Raises:
            KeyError: The parameter has no number of a gesture.
            ValueError, TypeError: It is not a number.
        """
        if request.api == LIST:
            presets = [{"id": number, "name": gesture.name} for number, gesture in GESTURES.items()]
            return rpc.OK, [[*presets, {"id": RELEASE, "name": "release_arm"}], []]  # Presets, custom [assumed].
        # The vendor's Python client sends ``data``, its C++ client ``action_id``.
        action = int(parameter["action_id"] if "action_id" in parameter else parameter["data"])
        if action != RELEASE and action not in GESTURES:
            return NO_SUCH_ACTION, None
        if fsm not in HANDSHAKE_FSM:
            return WRONG_FSM, None
        if self._run is None and self._arms.is_occupied(now_s):
            return OCCUPIED, None
        if self._run is None:
            if action == RELEASE:
                return rpc.OK, None
            self._run = _Run(action, now_s, self._position(), request)
            return None
        return self._end(action, request, now_s)

    def _end(self, action: int, request: Request, now_s: float) -> tuple[int, Any] | None:
        """Handle a request during a gesture. Only release, or a held gesture again, is accepted."""
        run = self._run
        assert run is not None
        if run.returns_s < math.inf or (action != RELEASE and not self._holds(run)):
            return OCCUPIED, None  # The running gesture has the topic [assumed].
        if action not in (RELEASE, run.action):
            return HOLDING, None
        self._answer(run.request, rpc.OK)
        self._run = run._replace(request=request, returns_s=now_s, end=self._position())
        return None

    def cancel(self) -> None:
        """End the gesture, because the robot has left the states in which it may make one."""
        if self._run is not None:
            self._answer(self._run.request, WRONG_FSM)
            self._run = None

    def advance(self, now_s: float) -> bool:
        """Command the arms for the time ``now_s``. Return True if they are commanded."""
        run = self._run
        if run is None:
            return False
        gesture = GESTURES[run.action]
        if now_s >= run.returns_s + RETURN_S:
            self._answer(run.request, rpc.OK)
            self._run = None
            self._arms.release()
            return True
        if run.returns_s < math.inf:
            share = _smooth((now_s - run.returns_s) / RETURN_S)
            self._command(gesture, [end + share * (to - end) for end, to in zip(run.end, run.start, strict=True)])
            return True
        passed_s = now_s - run.began_s
        swings_s = passed_s - REACH_S
        ends_s = REACH_S + (SWING_S if gesture.swing_rad else 0.0)
        q, share = list(run.start), _smooth(min(1.0, passed_s / REACH_S))
        for index, goal in self._goals(gesture, math.sin(math.tau * max(0.0, swings_s)) * gesture.swing_rad):
            q[index] += share * (goal - q[index])
        self._command(gesture, q)
        if passed_s >= ends_s and not gesture.holds:
            self._run = run._replace(end=q, returns_s=now_s)
        elif passed_s >= ends_s and run.request is not None:
            self._answer(run.request, rpc.OK)
            self._run = run._replace(request=None)
        elif passed_s >= ends_s + HOLD_S:
            self._run = run._replace(end=q, returns_s=now_s)
        return True

    def _goals(self, gesture: Gesture, swing_rad: float) -> list[tuple[int, float]]:
        """Return the joints of a gesture and their positions."""
        goals: list[tuple[int, float]] = []
        for arm, mirror in (("left", (1.0,) * len(_JOINTS)), ("right", _MIRROR)):
            if arm[0] in gesture.arms:
                pose = [rad + (swing_rad if place == _YAW else 0.0) for place, rad in enumerate(gesture.pose)]
                names = (f"{arm}_{joint}" for joint in _JOINTS)
                goals += [
                    (self._axes.index(name), rad * sign)
                    for name, rad, sign in zip(names, pose, mirror, strict=True)
                ]
        return goals

    def _command(self, gesture: Gesture, q: Sequence[float]) -> None:
        """Command the joints of a gesture. The onboard controller keeps the other joints."""
        zero = (0.0,) * len(q)
        joints = tuple(index for index, _ in self._goals(gesture, 0.0))
        self._arms.set(1.0, (q, zero, zero, (KP,) * len(q), (KD,) * len(q)), joints)

    def _answer(self, request: Request | None, code: int) -> None:
        if request is not None and not request.no_reply:
            self.responses.append(Response(request.id, request.api, code))
