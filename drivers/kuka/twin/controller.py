"""Simulate a KUKA controller: its FRI session, its pendant and its arm. No sockets.

Each call of ``cycle`` is one cycle of the controller. All thresholds of the session are [assumed], because the
vendor does not publish them.

The robot program runs a motion that holds one position (the interpolated position), and lets the client overlay it.
In COMMANDING_ACTIVE the arm goes to the client's positions, while the interpolated position stays where it is. The
motion, and with it the program, ends at a safety stop, with a drive that is not active, and at a command that the
controller cannot carry out. Then a person has to start the program again: no answer of a client can.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence

from msgspec.structs import replace

from strands_actors.drivers.common.physics.physics import Plant
from strands_actors.drivers.kuka.io import Io, IoDirection, IoType
from strands_actors.drivers.kuka.protocol import (
    COUNTER,
    JOINTS,
    ClientMode,
    Command,
    ControlMode,
    Drive,
    Monitoring,
    Overlay,
    Quality,
    State,
    name_of,
)
from strands_actors.drivers.kuka.robots import Arm

from .model import model_table

FAIR_AFTER, GOOD_AFTER, EXCELLENT_AFTER = 5, 20, 100
"""Numbers of consecutive answers after which the connection quality rises to FAIR, GOOD and EXCELLENT."""
POOR_AFTER, LOST_AFTER = 3, 10
"""Numbers of consecutive missed answers. With more, the quality becomes POOR, or the session drops to
monitoring."""
MIRRORED = 20
"""Consecutive answers that must repeat the interpolated position before the client may command."""
MIRROR_RAD = 1e-6
STEP_TOLERANCE = 1.001
AUTOMATIC = 2
LARGEST_DIGITAL = 1 << 64


class Controller:
    def __init__(
        self,
        arm: Arm,
        *,
        sample_ms: int = 10,
        multiplier: int = 1,
        now_s: Callable[[], float] = time.monotonic,
        note: Callable[[str], None] = lambda text: None,
        ios: Iterable[Io] = (),
    ) -> None:
        """Build the controller of ``arm``.

        Args:
            arm: The robot.
            sample_ms: Sample time.
            multiplier: The client must answer every so many cycles.
            now_s: The clock.
            note: Called with each new state of the session and its reason.
            ios: The inputs and outputs that the robot program registers, with their values at its start.
        """
        self.plant = Plant.from_table(model_table(arm))
        self.sample_ms = sample_ms
        self.multiplier = multiplier
        self.now_s = now_s
        self._note = note
        self._registered = tuple(ios)
        self._reach_rad = tuple(joint.reach_rad for joint in arm.joints)
        self._speed_rad_s = arm.speed_rad_s
        self.wake_up()

    def wake_up(self) -> None:
        """Reset to the state after a boot. The arm stays where it is.

        The robot program is already running, as if it had been started on the pendant.
        """
        self.motion = True  # True while the robot program runs a motion that the client may overlay.
        self.safety = 0
        self.drives = [int(Drive.ACTIVE)] * JOINTS
        self.control_mode = int(ControlMode.POSITION)
        self.client_mode = int(ClientMode.POSITION)
        self.overlay = int(Overlay.JOINT)
        self.ios = {io.name: io for io in self._registered}
        self.simulated = False  # True while a simulation, not an FRI client, sets the arm's targets.
        self.state = State.MONITORING_WAIT
        self.quality = Quality.POOR
        self._answer: Command | None = None
        self._sequence = 0
        self._reflected = 0
        self._good = self._missed = self._waited = self._mirrored = 0
        for joint in range(JOINTS):
            self.plant.set_torque(joint, True)
        self.stand()
        self.plant.catch_up(self.now_s())

    # -- the arm

    @property
    def is_commanded(self) -> bool:
        """True if the client's answers command the arm, or will soon (state COMMANDING_WAIT or later)."""
        return self.state >= State.COMMANDING_WAIT

    def stand(self) -> None:
        """Stop the arm and hold it at its present position."""
        self.set_targets(self.plant.position_rad)
        self._interpolated = self.commanded

    def set_targets(self, position_rad: Sequence[float]) -> None:
        self.commanded = tuple(position_rad)
        for joint, rad in enumerate(self.commanded):
            self.plant.set_target(joint, rad)

    # -- the person at the pendant, and the wires of the inputs

    def start_program(self) -> None:
        """Start the robot program. Raise ``ValueError`` if the controller cannot move the arm now."""
        if reason := self._reason_not_ready():
            raise ValueError(f"the program cannot start: {reason}. End that first")
        self.motion = True

    def set_io(self, name: str, value: int | float) -> None:
        """Set a registered input or output. Raise ``ValueError`` if there is none of this name, or if its type does
        not have the value."""
        if name not in self.ios:
            registered = ", ".join(self.ios) or "none"
            raise ValueError(f"no input or output {name} is registered. Registered: {registered}")
        io = self.ios[name]
        if io.type == IoType.BOOLEAN and value not in (0, 1):
            raise ValueError(f"{name} is boolean, and {value} is not 0 or 1")
        if io.type == IoType.DIGITAL and (not 0 <= value < LARGEST_DIGITAL or value != int(value)):
            raise ValueError(f"{name} is digital, and {value} is not a whole number of 64 bits")
        self.ios[name] = replace(io, value=value)

    def _set_outputs(self, requested: Iterable[Io]) -> None:
        """Set outputs as the client requests. A request that the vendor's client would not send (an unknown name,
        another type, an input) has no effect [assumed]."""
        for request in requested:
            io = self.ios.get(request.name)
            if io is None or io.type != request.type or io.direction != IoDirection.OUTPUT:
                kind = name_of(IoType, request.type).lower()
                self._note(f"no output {request.name} of type {kind} is registered")
                continue
            try:
                self.set_io(request.name, request.value)
            except ValueError as error:
                self._note(str(error))

    # -- one cycle

    def take_answer(self, command: Command) -> None:
        """Store the client's answer for the next cycle. A later answer in the same cycle replaces it."""
        self._answer = command

    def cycle(self) -> Monitoring:
        """Run one cycle: evaluate the client's answer to the last message, and return the next message."""
        answer, self._answer = self._answer, None
        answered = answer is not None and (self._sequence - answer.reflected) & COUNTER < self.multiplier
        if answer is not None and answered:
            self._reflected = answer.sequence
            self._set_outputs(answer.ios)
        self._judge(answered)
        reason = self._reason_not_movable()
        if self._reason_not_ready():
            self.motion = False
        if self._missed > LOST_AFTER and self.state > State.MONITORING_WAIT:
            self._leave(State.MONITORING_WAIT, "no answers")
        elif self.is_commanded and reason:
            self._leave(State.MONITORING_READY, reason)
        else:
            self._step(answer if answered else None)
        self.plant.catch_up(self.now_s())
        self._sequence = (self._sequence + 1) & COUNTER
        return self._message()

    def _judge(self, answered: bool) -> None:
        """Count received and missed answers, and compute the connection quality from them.

        The client must answer once in ``multiplier`` cycles.
        """
        self._waited = 0 if answered else self._waited + 1
        if answered:
            self._good, self._missed = self._good + 1, 0
        elif self._waited >= self.multiplier:
            self._waited = 0
            self._good, self._missed = 0, self._missed + 1
        if self._missed > POOR_AFTER:
            self.quality = Quality.POOR
        for after, quality in ((FAIR_AFTER, 1), (GOOD_AFTER, 2), (EXCELLENT_AFTER, 3)):
            if self._good >= after:
                self.quality = Quality(max(self.quality, quality))

    def _reason_not_ready(self) -> str:
        """Return why the controller can move the arm for no program. Empty if it can."""
        if self.safety:
            return "safety stop"
        return "a drive is off" if any(drive != Drive.ACTIVE for drive in self.drives) else ""

    def _reason_not_movable(self) -> str:
        return self._reason_not_ready() or ("" if self.motion else "the motion was ended")

    def _step(self, answer: Command | None) -> None:
        match self.state:
            case State.MONITORING_WAIT if self.quality >= Quality.GOOD:
                self._enter(State.MONITORING_READY, "good")
            case State.MONITORING_READY if self.quality is Quality.EXCELLENT and not self._reason_not_movable():
                self.simulated = False
                self.stand()
                self._mirrored = 0
                self._enter(State.COMMANDING_WAIT, "motion started")
            case State.COMMANDING_WAIT if answer is not None:
                off = self._off(answer.position, self._interpolated)
                self._mirrored = self._mirrored + 1 if off <= MIRROR_RAD else 0
                if self._mirrored >= MIRRORED:
                    self._enter(State.COMMANDING_ACTIVE, "mirrored")
            case State.COMMANDING_ACTIVE if answer is not None:
                self._obey(answer)

    def _obey(self, answer: Command) -> None:
        """Move the arm as the client commands. An impossible command ends the robot program.

        Positions that the program does not ask for (another client mode, no overlay) have no effect [assumed].
        """
        if not answer.position:
            self._abort("an answer without positions")
            return
        if self.client_mode != ClientMode.POSITION or self.overlay == Overlay.NO_OVERLAY:
            return
        cycle_s = self.sample_ms * self.multiplier / 1e3
        for joint, (rad, before) in enumerate(zip(answer.position, self.commanded, strict=True)):
            most = self._speed_rad_s[joint] * cycle_s * STEP_TOLERANCE
            if abs(rad - before) > most:
                self._abort(f"joint{joint + 1} steps {abs(rad - before):.5f} rad, limit {most:.5f}")
                return
            if abs(rad) > self._reach_rad[joint] * STEP_TOLERANCE:
                self._abort(f"joint{joint + 1} is past its end")
                return
        self.set_targets(answer.position)

    def _off(self, position: Sequence[float], goal: Sequence[float]) -> float:
        """Return the largest difference of one joint between ``position`` and ``goal``, in rad. Infinite if
        ``position`` is empty."""
        if not position:
            return float("inf")
        return max(abs(rad - goal_rad) for rad, goal_rad in zip(position, goal, strict=True))

    def mirrors(self, command: Command) -> bool:
        """Return True if a command only repeats the interpolated position, as COMMANDING_WAIT requires."""
        return self.state == State.COMMANDING_WAIT and self._off(command.position, self._interpolated) <= MIRROR_RAD

    def _abort(self, reason: str) -> None:
        """End the motion of the robot program. It can be started again only on the pendant."""
        self.motion = False
        self._leave(State.MONITORING_READY, f"aborted, {reason}")

    def _leave(self, state: State, reason: str) -> None:
        if self.is_commanded:
            self.stand()
        self._enter(state, reason)

    def _enter(self, state: State, reason: str) -> None:
        self.state = state
        self._note(f"{state.name}: {reason}")

    def _message(self) -> Monitoring:
        effort = tuple(self.plant.effort_nm)
        return Monitoring(
            sequence=self._sequence,
            reflected=self._reflected,
            safety=self.safety,
            drives=tuple(self.drives),
            operation_mode=AUTOMATIC,
            control_mode=self.control_mode,
            position=tuple(self.plant.position_rad),
            torque=effort,
            commanded=self.commanded,
            external_torque=(0.0,) * JOINTS,
            state=int(self.state),
            quality=int(self.quality),
            sample_ms=self.sample_ms,
            multiplier=self.multiplier,
            interpolated=self._interpolated if self.is_commanded else (),
            client_mode=self.client_mode if self.is_commanded else int(ClientMode.NO_COMMAND_MODE),
            overlay=self.overlay if self.is_commanded else int(Overlay.NO_OVERLAY),
            # The vendor's client documents 0 in all other states.
            tracking=1.0 if self.state == State.COMMANDING_ACTIVE else 0.0,
            ios=tuple(self.ios.values()),
        )
