"""Simulate the firmware's supervisor: a state machine that decides whether motors may turn.

    NOT_PASSED  the drone lies on its side
    PASSED      it may be armed
    ARMING      it is armed, and its motors spin up
    READY       motors may turn in this state and in the next three
    FLYING      a motor turned within the last two seconds
    LEVEL_OUT   no setpoint for half a second: it is kept level
    LANDED      no motor turned for two seconds. It disarms itself after a while
    RESET       it returns to the checks, and disarms itself
    FREE_FALL   motors off, on the way to LOCKED
    LOCKED      until it is switched off and on
    CRASHED     it tumbled in flight. Motors stay off until it stands upright and a client asks for a recovery

The firmware runs it 25 times a second, and its flags are those of the last run.

Source: the firmware's pages ``supervisor``, ``crash_handling`` and ``autonomous_flight``, and its behaviour in
version 2026.08.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

from strands_actors.drivers.crazyflie.protocol import Bit

PERIOD_S = 0.04
FLYING_S = 2.0
"""How long the drone counts as flying after its motors stopped."""
LEVEL_AFTER_S, CUT_AFTER_S = 0.5, 2.0
"""Ages of a setpoint at which the drone levels out, and falls."""
KEPT_ALIVE_S = 1.0
"""Longest pause between two packets that keep the emergency stop away, after the first of them."""
TILTED_G, TILTED_S = 0.5, 1.0
"""Acceleration along the drone's own axis below which it is tilted, and for how long until it counts as tumbled."""
UPSIDE_DOWN_G, UPSIDE_DOWN_S = -0.2, 0.1
"""The same for a drone on its back."""
FREE_FALL_G = 0.1


class State(enum.Enum):
    NOT_PASSED = enum.auto()
    PASSED = enum.auto()
    ARMING = enum.auto()
    READY = enum.auto()
    FLYING = enum.auto()
    LEVEL_OUT = enum.auto()
    LANDED = enum.auto()
    RESET = enum.auto()
    FREE_FALL = enum.auto()
    LOCKED = enum.auto()
    CRASHED = enum.auto()


MOTORS_MAY_TURN = frozenset({State.READY, State.FLYING, State.LEVEL_OUT, State.LANDED})
_ARMED = MOTORS_MAY_TURN | {State.ARMING}


class Seen(NamedTuple):
    """What the supervisor looks at.

    Attributes:
        now_s: The present time.
        thrust: True if a motor turns.
        acceleration_g: Measured acceleration in the drone's frame. A drone at rest measures (0, 0, 1).
        setpoint_age_s: Age of the present setpoint.
        high_level: Flags of the high-level commander.
    """

    now_s: float
    thrust: bool
    acceleration_g: Sequence[float]
    setpoint_age_s: float
    high_level: Bit


class Supervisor:
    def __init__(
        self, auto_arm: bool, spin_up_s: float, parameters: Mapping[str, float], note: Callable[[str], None]
    ) -> None:
        """Make a supervisor of a drone that has booted, and stands upright.

        Args:
            auto_arm: Arm without a request.
            spin_up_s: How long motors need to spin up after arming.
            parameters: Has the groups ``supervisor`` and ``stabilizer``.
            note: Called with a text for each action.
        """
        self._auto_arm = auto_arm
        self._spin_up_s = spin_up_s
        self._parameters = parameters
        self._note = note
        self.state = State.READY if auto_arm else State.PASSED
        self.armed = auto_arm
        self.crashed = self._tumbled = False
        self._emergency = False
        self._kept_alive_s: float | None = None
        self._entered_s = 0.0
        self._thrust_s: float | None = None
        self._tilted_s: float | None = None
        self.bits = Bit(0)
        self._tell(Bit.TRAJECTORY_FINISHED)

    # -- requests of clients

    @property
    def motors_may_turn(self) -> bool:
        return self.state in MOTORS_MAY_TURN

    def arm(self, arms: bool) -> bool:
        """Arm or disarm. Return False if it is refused."""
        if arms == self.armed:
            return True
        if arms and self.state is not State.PASSED:
            return False
        self.armed = arms
        return True

    def recover(self) -> bool:
        """End the state after a crash. Return False if it is refused."""
        if self.crashed and self._tumbled:
            return False
        self.crashed = False
        return True

    def stop_in_emergency(self) -> None:
        self._emergency = True

    def keep_alive(self, now_s: float) -> None:
        """Put the emergency stop off. It comes if the next packet of this kind is late."""
        self._kept_alive_s = now_s

    # -- time

    def update(self, seen: Seen) -> None:
        """Run the state machine once."""
        if seen.thrust:
            self._thrust_s = seen.now_s
        self._tumbled = self._is_tumbled(seen)
        after = self._next(seen)
        if after is not None and after is not self.state:
            self._enter(after, seen.now_s)
        self._tell(seen.high_level)

    def _next(self, seen: Seen) -> State | None:
        """Return the next state; None to stay."""
        flying = self._thrust_s is not None and seen.now_s - self._thrust_s < FLYING_S
        emergency = self._has_emergency(seen.now_s)
        late = seen.setpoint_age_s > CUT_AFTER_S
        match self.state:
            case State.FREE_FALL:
                return State.LOCKED
            case State.RESET:
                return State.NOT_PASSED
            case State.CRASHED:
                if not (self.crashed or self._tumbled):
                    return State.NOT_PASSED
                return State.LOCKED if emergency else None
            case State.LOCKED:
                return None
        if emergency and self.state is not State.LANDED:
            return State.FREE_FALL
        if late and self.state in (State.FLYING, State.LEVEL_OUT):
            self._note("watchdog: motors off")
            return State.FREE_FALL
        if self.state in (State.NOT_PASSED, State.PASSED, State.ARMING, State.READY):
            return self._next_on_the_floor(seen.now_s, flying)
        if self.state is State.LANDED:
            if self._waited_ms("supervisor.landedTimeout", seen.now_s) or not self.armed:
                return State.RESET
            return State.FLYING if flying else None
        if self.state is State.LEVEL_OUT:
            if self._tumbled:
                return State.FREE_FALL
            return None if seen.setpoint_age_s > LEVEL_AFTER_S else State.FLYING
        if self._tumbled:
            return State.CRASHED
        if not self.armed:
            return State.RESET
        if seen.setpoint_age_s > LEVEL_AFTER_S:
            return State.LEVEL_OUT
        return None if flying else State.LANDED

    def _next_on_the_floor(self, now_s: float, flying: bool) -> State | None:
        """Return the next state before the first flight; None to stay."""
        if self.state is State.NOT_PASSED:
            return None if self._tumbled else State.PASSED
        if self._tumbled:
            return State.NOT_PASSED
        if self.state is State.PASSED:
            return State.ARMING if self.armed else None
        if not self.armed:
            return State.NOT_PASSED
        if self.state is State.ARMING:
            if now_s - self._entered_s >= self._spin_up_s:
                return State.READY
            return State.NOT_PASSED if self._waited_ms("supervisor.spinupTimeout", now_s) else None
        if self._waited_ms("supervisor.prefltTimeout", now_s):
            return State.NOT_PASSED
        return State.FLYING if flying else None

    def _enter(self, state: State, now_s: float) -> None:
        self.state, self._entered_s = state, now_s
        match state:
            case State.LEVEL_OUT:
                self._note("watchdog: level")
            case State.LOCKED:
                self._note("supervisor: locked")
            case State.CRASHED:
                self._note("supervisor: crashed")
                self.crashed = True
        if state not in _ARMED:
            self.armed = self._auto_arm and state is State.PASSED

    def _waited_ms(self, parameter: str, now_s: float) -> bool:
        return (now_s - self._entered_s) * 1e3 > self._parameters[parameter]

    def _has_emergency(self, now_s: float) -> bool:
        if self._kept_alive_s is not None and now_s - self._kept_alive_s > KEPT_ALIVE_S:
            self._emergency = True
        return self._emergency or bool(self._parameters["stabilizer.stop"])

    def _is_tumbled(self, seen: Seen) -> bool:
        if not self._parameters["supervisor.tmblChckEn"]:
            return False
        crash_g, norm_g = self._parameters["supervisor.crashDetectGs"], math.hypot(*seen.acceleration_g)
        if 0 < crash_g < abs(norm_g - 1.0):
            return True
        *_, down_g = seen.acceleration_g
        if all(abs(value) < FREE_FALL_G for value in seen.acceleration_g) or down_g >= TILTED_G:
            self._tilted_s = None
            return False
        if self._tilted_s is None:
            self._tilted_s = seen.now_s
        tilted_s = seen.now_s - self._tilted_s
        return tilted_s > TILTED_S or (down_g < UPSIDE_DOWN_G and tilted_s > UPSIDE_DOWN_S)

    def _tell(self, high_level: Bit) -> None:
        """Set the flags that clients see."""
        flags = {
            Bit.CAN_BE_ARMED: self.state is State.PASSED,
            Bit.ARMED: self.armed,
            Bit.AUTO_ARMED: self._auto_arm,
            Bit.CAN_FLY: self.motors_may_turn,
            Bit.FLYING: self.state in (State.FLYING, State.LEVEL_OUT),
            Bit.TUMBLED: self._tumbled,
            Bit.LOCKED: self.state is State.LOCKED,
            Bit.CRASHED: self.crashed,
        }
        self.bits = Bit(sum(bit for bit, on in flags.items() if on)) | high_level


__all__ = ["PERIOD_S", "Seen", "State", "Supervisor"]
