"""The twin's onboard computer: states, modes, services, battery, and control of the body. It knows no
network.

Each call passes the time; between calls nothing happens.
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

from .body import body_of
from .gait import Gait, Pose
from .loco import LocoGait
from .sport import SportGait

STAND_KP, STAND_KD = 1000.0, 20.0
"""Gains of the onboard controller, which only stands."""

ROOM_C = 30
MODE_MACHINE = 5
"""``mode_machine`` of a G1 with 29 joints [assumed]."""


class Onboard:
    """The onboard computer of one robot. ``note(kind, text)`` is called with its events: ``fsm``, ``mode``,
    ``fell``, ``stood``, ``silence``, and ``gait`` and ``twist`` of its gait."""

    def __init__(
        self,
        model: Model,
        note: Callable[[str, str], None],
        silence_s: float = 0.0,
        simulator: bool = False,
        body: LeggedBody | None = None,
        keeps_s: float = 1.0,
    ) -> None:
        """Make the computer and its body.

        Args:
            model: The robot.
            note: Called with each event.
            silence_s: Without a LowCmd for this time the robot damps; 0: never.
            simulator: It accepts every LowCmd in any mode.
            body: Replaces the body of the robot's table.
            keeps_s: A velocity ends by itself after this time; 0: never.
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
        """The gait; None if this package does not know how the robot walks."""
        self._way: tuple[Sequence[float], Sequence[float]] | None = (
            None  # the poses between which it moves, from and to
        )
        self._stand = (home, self._zero, self._zero, (STAND_KP,) * count, (STAND_KD,) * count)
        self._brake = (self._zero, self._zero, self._zero, self._zero, (model.damp_kd,) * count)
        self._limp = (self._zero,) * 5
        self._tick = 0
        self.reset()

    def reset(self) -> None:
        """Return to the state after a boot, standing."""
        self.body.stand_up()
        self.mode = self.model.sport_mode
        if self.gait is not None:
            self.gait.reset()
        self.fallen = False
        self._commanded_s = 0.0
        self.commanded = False
        """True if the newest LowCmd asks for torque, and is obeyed."""
        self.obey_itself()

    def _make_gait(self, keeps_s: float) -> Gait | None:
        walks = self.model.walks
        if walks is None:
            return None
        dialect = dialect_of(walks)
        if isinstance(dialect, LocoDialect):
            return LocoGait(self._gait_changed, keeps_s, dialect)
        return SportGait(self._gait_changed, keeps_s, walks.sits)

    # -- control of the body

    @property
    def fsm_id(self) -> int | None:
        """The FSM id; None if the robot has no state machine."""
        return self.gait.mode if isinstance(self.gait, LocoGait) else None

    @property
    def machine(self) -> int:
        """Its ``mode_machine``, which every LowCmd has to repeat; 0 if there is no such field."""
        return MODE_MACHINE if self.model.family == "hg" and not self._simulator else 0

    @property
    def takes_commands(self) -> bool:
        """True if it obeys a LowCmd."""
        if self._simulator:
            return True
        if self.model.handshake == "fsm":
            return self.fsm_id in HANDSHAKE_FSM
        return not self.mode

    def command(self, command: Command, now_s: float) -> None:
        """Take a LowCmd with a right checksum. The newest one applies until another event. A LowCmd for
        another ``mode_machine`` is ignored [assumed: the vendor's examples copy the number from LowState]."""
        if not self.takes_commands or command.machine != self.machine:
            return
        active = [1.0 if mode else 0.0 for mode in command.mode]
        rows = (command.q, command.dq, command.tau, command.kp, command.kd)
        self.body.drive(*([value * on for value, on in zip(row, active, strict=True)] for row in rows))
        self._commanded_s = now_s
        self.commanded = any(command.tau) or any(command.kp) or any(command.kd)

    def lead(self, rows: Sequence[Sequence[float]], which: Sequence[float]) -> None:
        """Drive the joints that the flags name. The onboard controller drives the others."""
        mixed = (
            [value if led else own for value, own, led in zip(row, stand, which, strict=True)]
            for row, stand in zip(rows, self._stand, strict=True)
        )
        self.body.drive(*mixed)

    def set_fsm(self, number: int) -> None:
        """Set the state of the state machine, if there is one, as the robot's remote does."""
        if isinstance(self.gait, LocoGait):
            self.gait.become(number)
            self.obey_itself()

    def set_mode(self, name: str) -> None:
        self.mode = name
        self._note("mode", name)
        self.obey_itself()

    def obey_itself(self) -> None:
        """Let the onboard controller drive the body, by its mode, its FSM and its posture."""
        self._commanded_s = 0.0
        self.commanded = False
        pose = Pose.UP if self.gait is None else self.gait.pose
        if pose is Pose.LIMP or pose is Pose.BRAKED or not self.mode:
            self._way = None
            self.body.drive(*(self._limp if pose is Pose.LIMP else self._brake))
            return
        to = self._lie if pose is Pose.DOWN else self._stand[0]
        rests = pose is Pose.UP and (self.gait is None or self.gait.share >= 1.0)
        self._way = None if rests else (self.body.position_rad, to)
        self._drive_way()

    @property
    def _is_down(self) -> bool:
        """True if the onboard controller has laid the robot down, or is about to."""
        return self.gait is not None and self.gait.pose is Pose.DOWN

    def _drive_way(self) -> bool:
        """Move on to the next pose, as far as the gait is. Return True if the body is there."""
        if self._way is None or self.gait is None:
            self.body.drive(*self._stand)
            return True
        share = self.gait.share
        q = [(1.0 - share) * at + share * to for at, to in zip(*self._way, strict=True)]
        self.body.drive(q, *self._stand[1:])
        if share < 1.0:
            return False
        self._way = None
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
        if self.gait is not None and self.mode:
            walked_s = self.gait.advance(now_s)
            if walked_s:
                self.body.carry(*self.gait.twist, walked_s)
            if self._way is not None and self._drive_way() and isinstance(self.gait, LocoGait):
                self._hang_up()
        self.body.catch_up(now_s)
        self._tick += 1
        if self.body.fallen != self.fallen and not self._is_down:
            self.fallen = not self.fallen
            self._note("fell" if self.fallen else "stood", f"{self.body.height_m:.3f}")

    def _hang_up(self) -> None:
        """Put a G1 or an H1 that has stood up on its feet, since a hanger holds it meanwhile."""
        if self.body.fallen and not self._is_down:
            self.body.stand_up()
            self.body.drive(*self._stand)

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
        """Return the state of the onboard controller; None if it publishes no state."""
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
        return (rpc.MOTION_SWITCHER, self.model.service)

    def serve(self, service: str, request: Request) -> Response | None:
        """Return the answer to a request; None for no answer."""
        try:
            parameter = rpc.parsed(request.parameter)
            if service == rpc.MOTION_SWITCHER:
                answer = self._switch(request.api, parameter)
            elif not self.mode:
                return None  # the service belongs to the mode that was released
            else:
                answer = self._sport(request.api, parameter)
        except (MalformedFrame, KeyError, TypeError, ValueError):
            answer = rpc.BAD_DATA, None
        code, data = answer
        return Response(request.id, request.api, code, "" if data is None else json.dumps(data))

    def _switch(self, api: int, parameter: dict[str, Any]) -> tuple[int, Any]:
        match api:
            case rpc.SERVER_VERSION:
                return rpc.OK, "1.0.0.1"
            case rpc.CHECK_MODE:
                return rpc.OK, {"form": "0", "name": self.mode}
            case rpc.SELECT_MODE:
                self.set_mode(str(parameter["name"]))
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
