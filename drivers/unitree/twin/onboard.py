"""Simulate the onboard computer of a robot: states, modes, services, battery, and control of the body.

This module has no network, and no own clock: time advances only in ``advance``.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Sequence
from typing import Any

from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.drivers.common.physics.legged_body import LeggedBody
from strands_actors.drivers.unitree import rpc
from strands_actors.drivers.unitree.gates import HANDSHAKE_FSM
from strands_actors.drivers.unitree.protocol import Command, State
from strands_actors.drivers.unitree.robots import Model
from strands_actors.drivers.unitree.rpc import Request, Response
from strands_actors.drivers.unitree.walking.loco import LocoDialect
from strands_actors.drivers.unitree.walking.robots import dialect_of
from strands_actors.drivers.unitree.walking.states import SportState

from .arm_actions import SERVICE as ARM
from .arm_actions import VERSION as ARM_VERSION
from .arm_actions import ArmActions
from .arm_sdk import SLOTS, ArmSdk, Rows
from .body import body_of
from .gait import Gait, Pose
from .loco import LocoGait
from .obstacles import SERVICE as OBSTACLES
from .obstacles import VERSION as OBSTACLES_VERSION
from .obstacles import ObstacleAvoidance
from .requests import NO_SUCH_MODE, modelled_by
from .sport import SportGait

STAND_KP, STAND_KD = 1000.0, 20.0
"""Gains with which the onboard controller holds the joints while the robot stands."""

ROOM_C = 30
MODE_MACHINE = 5
"""``mode_machine`` of a G1 with 29 joints (``g1_29dof_rev_1_0`` in the vendor's table of its robot descriptions).
The number of an H1-2 is [assumed]."""


class Onboard:
    """The simulated onboard computer of one robot.

    It calls ``note(kind, text)`` at each event. The kinds are ``fsm``, ``mode``, ``fell``, ``stood``, ``silence``,
    ``gait`` and ``twist``.
    """

    def __init__(
        self,
        model: Model,
        note: Callable[[str, str], None],
        silence_s: float = 0.0,
        simulator: bool = False,
        body: LeggedBody | None = None,
        keeps_s: float = 1.0,
    ) -> None:
        """Build the computer and the body.

        Args:
            model: The type of robot.
            note: Called with the kind and the text of each event.
            silence_s: If no LowCmd arrives for this time, the joints brake. 0: they never brake by themselves.
            simulator: True to behave like Unitree's simulator, which obeys a LowCmd in every mode.
            body: A body to use instead of the one in ``robots.toml``.
            keeps_s: A velocity ends by itself after this time. 0: no limit.
        """
        self.model = model
        self._simulator = simulator
        self.body = body or body_of(model)
        self.soc: int | None = 80
        self._note = note
        self._silence_s = silence_s
        count = len(model.joints)
        self._zero = (0.0,) * count
        home = tuple(self.body.position_rad)
        self._lie = model.walks.lie_rad if model.walks and model.walks.lie_rad else home
        self.gait = self._make_gait(keeps_s)
        """The simulated walking service. None if this package cannot make the robot walk."""
        # First and last pose of the present change of posture, or None.
        self._pose_change: tuple[Sequence[float], Sequence[float]] | None = None
        self._stand = (home, self._zero, self._zero, (STAND_KP,) * count, (STAND_KD,) * count)
        self._brake = (self._zero, self._zero, self._zero, self._zero, (model.damp_kd,) * count)
        self._limp = (self._zero,) * 5
        # The commands of the onboard controller that are in force. None while a LowCmd is.
        self._own: Rows | None = None
        humanoid = model.name in SLOTS and not simulator
        self.arms = ArmSdk(model) if humanoid else None
        """The topic ``rt/arm_sdk``; None for other robots."""
        fsm = self.arms is not None and model.handshake == "fsm"
        self.actions = ArmActions(model, self.arms, lambda: self.body.position_rad) if fsm and self.arms else None
        """The service ``arm``; None for other robots."""
        avoids = isinstance(self.gait, SportGait) and model.walks is not None and model.walks.sits
        self.obstacles = ObstacleAvoidance(self.gait, self.body) if avoids and self.gait else None
        """The service ``obstacles_avoid``; None for other robots."""
        self._tick = 0
        self.reset()

    def reset(self) -> None:
        """Reset to the state after a boot. The robot stands."""
        self.body.stand_up()
        self.mode = self.model.sport_mode
        if self.gait is not None:
            self.gait.reset()
        self.fallen = False
        self._now_s = self._commanded_s = 0.0
        if self.actions is not None:
            self.actions.reset()
        if self.obstacles is not None:
            self.obstacles.reset()
        self.commanded = False
        """True if the newest LowCmd commands torque, and the robot obeys it."""
        self.obey_itself()

    def _make_gait(self, keeps_s: float) -> Gait | None:
        walks = self.model.walks
        if walks is None:
            return None
        dialect = dialect_of(walks)
        if isinstance(dialect, LocoDialect):
            return LocoGait(self._gait_changed, keeps_s, dialect)
        return SportGait(self._gait_changed, keeps_s, walks.sits)

    # -- which controller commands the joints

    @property
    def fsm_id(self) -> int | None:
        """The number of the state machine's state (FSM id). None if the robot has no state machine."""
        return self.gait.mode if isinstance(self.gait, LocoGait) else None

    @property
    def machine(self) -> int:
        """The robot's ``mode_machine``, a number that every LowCmd must repeat. 0 if its frames have no such
        field."""
        return MODE_MACHINE if self.model.family == "hg" and not self._simulator else 0

    @property
    def takes_commands(self) -> bool:
        """True if the robot obeys a LowCmd in its present state.

        Without an onboard mode every robot does: the vendor calls it debug mode on a G1. Its example of the low
        level (g1_low_level_example) releases the mode first, in any state.
        """
        if self._simulator or not self.mode:
            return True
        return self.model.handshake == "fsm" and self.fsm_id in HANDSHAKE_FSM

    def command(self, command: Command, now_s: float) -> None:
        """Carry out a LowCmd, until the next command or event.

        A LowCmd with another ``mode_machine`` is ignored without an answer, as users of real robots report (pull
        request 2861 of dimensionalOS/dimos). The vendor's examples copy the number from LowState. A motor whose
        command has a number that is not finite gets no torque [assumed].
        """
        if not self.takes_commands or command.machine != self.machine:
            return
        rows: Rows = (command.q, command.dq, command.tau, command.kp, command.kd)
        if not all(command.mode) or not all(all(map(math.isfinite, row)) for row in rows):
            rows = self._without_idle_motors(command.mode, rows)
        self._own = None
        self.body.drive(*rows)
        self._commanded_s = now_s
        self.commanded = any(command.tau) or any(command.kp) or any(command.kd)

    @staticmethod
    def _without_idle_motors(modes: Sequence[int], rows: Rows) -> Rows:
        """Return the rows with 0 for each motor that is off or has a number that is not finite."""
        finite = (all(map(math.isfinite, column)) for column in zip(*rows, strict=True))
        active = [bool(mode) and sound for mode, sound in zip(modes, finite, strict=True)]
        return [[value if on else 0.0 for value, on in zip(row, active, strict=True)] for row in rows]

    def set_targets(self, rows: Sequence[Sequence[float]], selected: Sequence[float]) -> None:
        """Command the joints for which ``selected`` is 1. A physics simulation in another process calls this. The
        onboard controller holds the other joints."""
        mixed = (
            [value if led else own for value, own, led in zip(row, stand, selected, strict=True)]
            for row, stand in zip(rows, self._stand, strict=True)
        )
        self._drive(list(mixed))

    # -- the arms of a humanoid

    @property
    def _takes_arms(self) -> bool:
        """True if the onboard controller mixes commands from ``rt/arm_sdk`` into its own: while it balances."""
        return bool(self.mode) and self._own is not None and (self.gait is None or self.gait.walks)

    def command_arms(self, body: bytes, now_s: float) -> None:
        """Carry out a message of ``rt/arm_sdk``. It is ignored while the onboard controller does not balance.

        Raises:
            MalformedFrame: The message cannot be read.
        """
        if self.arms is not None and self._takes_arms:
            self.arms.take(body, now_s)
            self._drive(self._own or ())

    def _drive(self, own: Rows) -> None:
        """Command the joints as the onboard controller does, with the commands for the arms mixed in."""
        self._own = own
        if self.arms is not None and not self._takes_arms:
            self.arms.release()
        self.body.drive(*(own if self.arms is None else self.arms.mixed_into(own)))

    def _advance_arms(self, now_s: float) -> None:
        if self.actions is None:
            return
        if not self._takes_arms:
            self.actions.cancel()
        elif self.actions.advance(now_s):
            self._drive(self._own or ())

    @property
    def arm_joints(self) -> Sequence[int]:
        """The indices of the joints that ``rt/arm_sdk`` commands now."""
        return () if self.arms is None else self.arms.commanded

    def take_responses(self) -> list[Response]:
        """Return the responses to earlier requests to the service ``arm`` that are due now, each once."""
        if self.actions is None:
            return []
        due, self.actions.responses = self.actions.responses, []
        return due

    def set_fsm(self, number: int) -> None:
        """Set the state of the state machine, as a person does by the remote. Ignored without a state machine."""
        if isinstance(self.gait, LocoGait):
            self.gait.become(number)
            self.obey_itself()

    def set_mode(self, name: str) -> None:
        self.mode = name
        self._note("mode", name)
        self.obey_itself()

    def obey_itself(self) -> None:
        """Let the onboard controller command the joints, as its mode, its state and its posture require."""
        self._commanded_s = 0.0
        self.commanded = False
        pose = Pose.UP if self.gait is None else self.gait.pose
        if pose is Pose.LIMP or pose is Pose.BRAKED or not self.mode:
            self._pose_change = None
            self._drive(self._limp if pose is Pose.LIMP else self._brake)
            return
        to = self._lie if pose is Pose.DOWN else self._stand[0]
        rests = pose is Pose.UP and (self.gait is None or self.gait.share >= 1.0)
        self._pose_change = None if rests else (self.body.position_rad, to)
        self._drive_pose_change()

    @property
    def _is_down(self) -> bool:
        """True if the onboard controller has laid the robot down, or is laying it down."""
        return self.gait is not None and self.gait.pose is Pose.DOWN

    def _drive_pose_change(self) -> bool:
        """Move the joints towards the next pose, as far as the change has progressed. Return True at its end."""
        if self._pose_change is None or self.gait is None:
            self._drive(self._stand)
            return True
        share = self.gait.share
        q = [(1.0 - share) * start + share * end for start, end in zip(*self._pose_change, strict=True)]
        self._drive((q, *self._stand[1:]))
        if share < 1.0:
            return False
        self._pose_change = None
        return True

    def _gait_changed(self, kind: str, text: str) -> None:
        self._note(kind, text)
        if self.mode and self.gait is not None and self.gait.pose is Pose.BRAKED and kind == "gait":
            self.obey_itself()

    def advance(self, now_s: float) -> None:
        if self._silence_s and self._commanded_s and now_s - self._commanded_s > self._silence_s:
            self._commanded_s = 0.0
            self.commanded = False
            self.body.drive(*self._brake)
            self._note("silence", "")
        self._now_s = now_s
        self._advance_arms(now_s)
        if self.obstacles is not None and self.mode:
            self.obstacles.advance(now_s)
        if self.gait is not None and self.mode:
            walked_s = self.gait.advance(now_s)
            if walked_s:
                self.body.carry(*self.gait.twist, walked_s)
            if self._pose_change is not None and self._drive_pose_change() and isinstance(self.gait, LocoGait):
                self._hang_up()
        self.body.catch_up(now_s)
        self._tick += 1
        if self.body.fallen != self.fallen and not self._is_down:
            self.fallen = not self.fallen
            self._note("fell" if self.fallen else "stood", f"{self.body.height_m:.3f}")

    def _hang_up(self) -> None:
        """If the robot has fallen while it stood up, put it back on its feet. A real G1 or H1 hangs in a hanger
        while it stands up."""
        if self.body.fallen and not self._is_down:
            self.body.stand_up()
            self._drive(self._stand)

    def state(self) -> State:
        body = self.body
        return State(
            self.machine,
            self._tick & 0xFFFFFFFF,
            body.orientation_wxyz,
            body.gyro_rad_s,
            body.acceleration_m_s2,
            body.position_rad,
            body.velocity_rad_s,
            body.effort_nm,
            (ROOM_C,) * len(self.model.joints),
            self.soc if self.model.family == "go" else None,
        )

    def sport_state(self, now_ns: int) -> SportState | None:
        """Return the SportModeState of the onboard controller. None if no onboard mode is active."""
        gait = self.gait
        if gait is None or not self.mode:
            return None
        half = gait.heading_rad / 2.0
        heading = (math.cos(half), 0.0, 0.0, math.sin(half))
        x, y = gait.position
        height_m = self.body.height_m
        mode = 0 if isinstance(gait, LocoGait) else gait.mode
        return SportState(now_ns, mode, (x, y, height_m), gait.twist, heading, height_m)

    # -- services

    @property
    def services(self) -> tuple[str, ...]:
        others = ((ARM, self.actions), (OBSTACLES, self.obstacles))
        return (rpc.MOTION_SWITCHER, self.model.service, *(name for name, server in others if server is not None))

    def serve(self, service: str, request: Request) -> Response | None:
        """Return the response to a request. None if the service does not answer, or answers later
        (``take_responses``)."""
        if service == self.model.service and not self.mode:
            return None  # The onboard mode was released, and this service has ended with it.
        answer: tuple[int, Any] | None
        try:
            parameter = rpc.parsed(request.parameter)
            if request.api not in modelled_by(self.model, service):
                answer = rpc.NOT_IMPLEMENTED, None
            elif service == rpc.MOTION_SWITCHER:
                answer = self._switch(request.api, parameter)
            elif service == ARM and self.actions is not None:
                answer = self._order_gesture(request, parameter)
            elif service == OBSTACLES and self.obstacles is not None:
                version = request.api == rpc.SERVER_VERSION
                answer = (rpc.OK, OBSTACLES_VERSION) if version else self.obstacles.order(request.api, parameter)
            else:
                answer = self._sport(request.api, parameter)
        except (MalformedFrame, KeyError, TypeError, ValueError):
            answer = rpc.BAD_DATA, None
        if answer is None:
            return None
        code, data = answer
        return Response(request.id, request.api, code, "" if data is None else json.dumps(data))

    def _order_gesture(self, request: Request, parameter: dict[str, Any]) -> tuple[int, Any] | None:
        assert self.actions is not None
        if request.api == rpc.SERVER_VERSION:
            return rpc.OK, ARM_VERSION
        fsm = self.fsm_id if self._takes_arms else None
        return self.actions.order(request, parameter, self._now_s, fsm)

    def _switch(self, api: int, parameter: dict[str, Any]) -> tuple[int, Any]:
        match api:
            case rpc.SERVER_VERSION:
                return rpc.OK, "1.0.0.1"
            case rpc.CHECK_MODE:
                return rpc.OK, {"form": "0", "name": self.mode}
            case rpc.SELECT_MODE:
                if parameter["name"] != self.model.sport_mode:
                    return NO_SUCH_MODE, None
                self.set_mode(self.model.sport_mode)
                return rpc.OK, None
            case rpc.RELEASE_MODE:
                self.set_mode("")
                return rpc.OK, None
        return rpc.NOT_IMPLEMENTED, None

    def _sport(self, api: int, parameter: dict[str, Any]) -> tuple[int, Any]:
        if api == rpc.SERVER_VERSION:
            return rpc.OK, "1.0.0.0"
        if self.gait is None:
            return rpc.NOT_IMPLEMENTED, None
        before = self.gait.mode, self.gait.next_mode
        answer = self.gait.order(api, parameter)
        if (self.gait.mode, self.gait.next_mode) != before:
            self.obey_itself()
        return answer
