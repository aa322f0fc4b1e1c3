"""Store the newest reports of boards and servo chains, and convert them to an ``Observation``."""

from __future__ import annotations

import math
from collections.abc import Sequence

from strands_actors.contract.wire import Observation

from . import protocol as p
from .config import ARM, BASE, LEFT, LIFT, PIMU, RIGHT, StretchConfig
from .odometry import Odometry

SERVO_ROWS = ("voltage_v", "voltage_min_v", "voltage_max_v", "temperature_c", "temperature_max_c")
"""Sensors of the chains, as the gates of servos take them. NaN for an axis without a servo."""


CONTACT, UNHELD = "contact", "safety mode"
"""Words in ``faults`` of an energised lift or arm. ``CONTACT``: its board has stopped it at a contact.
``UNHELD``: its board is in its safety mode although no runstop is pressed."""


class Readings:
    """The newest reports of all boards. ``homed`` and ``limits`` have an entry for each joint. The limits are
    those at present."""

    def __init__(self, config: StretchConfig, pimu_hardware: int) -> None:
        self._config = config
        self._hardware = pimu_hardware
        self._steppers: dict[str, p.StepperStatus] = {}
        self._pimu: p.PimuStatus | None = None
        self._stamp_ns: dict[str, int] = {}
        # Since when each board has not answered. Boards that answered the last call are missing.
        self._silent_since_ns: dict[str, int] = {}
        # Steppers that are energised.
        self._energised: set[str] = set()
        # Energised steppers that have reported a contact since they were energised.
        self._contacted: set[str] = set()
        self._odometry = Odometry(config.parameters.separation_m)
        self.limits: dict[str, tuple[float, float]] = {}
        self.homed: dict[str, bool] = {}
        self.has_watchdog = False

    def stepper(self, board: str, status: p.StepperStatus | None, now_ns: int) -> bool:
        """Store the status of a stepper.

        A report in which the board's time has not changed counts as missing, because the firmware may hang.

        Returns:
            False if the board was reset, because its clock started anew.
        """
        before = self._steppers.get(board)
        if status is None or not self._is_new(board, status, before, now_ns):
            self._silent_since_ns.setdefault(board, now_ns)
            return True
        self._steppers[board] = status
        if board in self._energised and (status.has(p.Diag.CONTACT) or _met_between(before, status)):
            self._contacted.add(board)
        return before is None or status.timestamp_us > before.timestamp_us

    def store_energised(self, board: str, status: p.StepperStatus, now_ns: int) -> None:
        """Store the status of a stepper that was just energised. Contacts from before that no longer count."""
        self.stepper(board, status, now_ns)
        self._energised.add(board)
        self._contacted.discard(board)

    def clear_energised(self) -> None:
        self._energised.clear()

    def pimu(self, status: p.PimuStatus | None, now_ns: int) -> bool:
        """Store the status of the power board; None if it did not answer. Return False if the board was reset."""
        before = self._pimu
        if status is None or not self._is_new(PIMU, status, before, now_ns):
            self._silent_since_ns.setdefault(PIMU, now_ns)
            return True
        self._pimu = status
        return before is None or status.timestamp_us > before.timestamp_us

    def _is_new(
        self,
        board: str,
        status: p.StepperStatus | p.PimuStatus,
        before: p.StepperStatus | p.PimuStatus | None,
        now_ns: int,
    ) -> bool:
        """Store the arrival time of a report. Return False if the board's time has not changed."""
        if before is not None and status.timestamp_us == before.timestamp_us:
            return False
        self._silent_since_ns.pop(board, None)
        self._stamp_ns[board] = now_ns
        return True

    def silent_for_ns(self, board: str, now_ns: int) -> int:
        return now_ns - self._silent_since_ns.get(board, now_ns)

    def observation(self, chains: Sequence[Observation], now_ns: int) -> Observation:
        lift, arm = (self._metres(name) for name in (LIFT, ARM))
        left, right = (self._metres(name) for name in (LEFT, RIGHT))
        vx, wz = self._config.twist(left[1], right[1])
        wheels_ns = min(self._stamp_ns.get(name, 0) for name in (LEFT, RIGHT))
        if math.isfinite(left[0]) and math.isfinite(right[0]):
            self._odometry.take(left[0], right[0])
        servos = [
            row for chain in chains for row in zip(chain.position, chain.velocity, chain.stamp_ns, strict=True)
        ]
        rows = [
            (*lift, self._stamp_ns.get(LIFT, 0)),
            (*arm, self._stamp_ns.get(ARM, 0)),
            *servos,
            (vx, math.nan, wheels_ns),
            (wz, math.nan, wheels_ns),
        ]
        return Observation(
            t_ns=now_ns,
            position=tuple(row[0] for row in rows),
            stamp_ns=tuple(row[2] for row in rows),
            velocity=tuple(row[1] for row in rows),
            sensors={**self._base(vx, wz), **self._power(), **self._joints(), **_servos(chains)},
            faults={**self._faults(), **{key: words for chain in chains for key, words in chain.faults.items()}},
        )

    def _metres(self, name: str) -> tuple[float, float]:
        status, scale = self._steppers.get(name), self._config.motors[name].rad_per_m
        return (math.nan, math.nan) if status is None else (status.position / scale, status.velocity / scale)

    def _base(self, vx: float, wz: float) -> dict[str, tuple[float, ...]]:
        pose = self._odometry.pose
        return {
            "odometry_xy_m": (pose.x_m, pose.y_m),
            "odometry_yaw_rad": (pose.yaw_rad,),
            "odometry_linear_m_s": (vx, 0.0),
            "odometry_angular_rad_s": (wz,),
            "wheel_watchdog": (float(self.has_watchdog),),
        }

    def _power(self) -> dict[str, tuple[float, ...]]:
        status = self._pimu
        if status is None:
            return {}
        steppers_stopped = any(each.has(p.Diag.RUNSTOP) for each in self._steppers.values())
        runstop = bool(status.state & p.State.RUNSTOP) or steppers_stopped
        roll, pitch, heading = (math.radians(angle) for angle in status.roll_pitch_heading)
        return {
            "runstop": (float(runstop),),
            "battery_v": (status.voltage_v,),
            "battery_a": (status.current_a(self._hardware),),
            "charging": (float(bool(status.state & p.State.CHARGER)),),
            "low_battery": (float(bool(status.state & p.State.LOW_VOLTAGE)),),
            "high_current": (float(bool(status.state & p.State.HIGH_CURRENT)),),
            "tilted": (float(bool(status.state & p.State.OVER_TILT)),),
            "at_cliff": (float(bool(status.state & p.State.CLIFF)),),
            "rpy_rad": (roll, pitch, math.remainder(heading, math.tau)),
            "gyro_rad_s": status.gyro,
            "acceleration_m_s2": status.acceleration,
            "orientation_wxyz": status.orientation,
        }

    def _joints(self) -> dict[str, tuple[float, ...]]:
        """Return for all axes, in their order, whether they are homed, and their limits. The base has no limits
        and needs no homing."""
        axes = self._config.axes
        anywhere = (-math.inf, math.inf)
        homed = {**self.homed}
        for name in (LIFT, ARM):
            status = self._steppers.get(name)
            homed[name] = status is not None and status.has(p.Diag.HOMED)
        return {
            "homed": tuple(float(axis in BASE or homed.get(axis, False)) for axis in axes),
            "limit_low": tuple(self.limits.get(axis, anywhere)[0] for axis in axes),
            "limit_high": tuple(self.limits.get(axis, anywhere)[1] for axis in axes),
        }

    def _faults(self) -> dict[str, str]:
        axes_of = {LIFT: (LIFT,), ARM: (ARM,), LEFT: BASE, RIGHT: BASE, PIMU: ()}
        words = {joint: [self._word_of(joint)] for joint in (LIFT, ARM)}
        for board in self._silent_since_ns:
            for axis in axes_of[board]:
                words.setdefault(axis, []).append("silent")
        return {axis: text for axis, all_ in words.items() if (text := ", ".join(filter(None, all_)))}

    def _word_of(self, joint: str) -> str:
        status = self._steppers.get(joint)
        if joint in self._contacted:
            return CONTACT
        is_safe = status is not None and status.mode == p.Mode.SAFETY and not status.has(p.Diag.RUNSTOP)
        return UNHELD if is_safe and joint in self._energised else ""


def _met_between(before: p.StepperStatus | None, now: p.StepperStatus) -> bool:
    """Return True if a stepper has met a contact and got a new goal before the contact was read. While a
    stepper follows a goal, its board counts only contacts. In other modes it also counts the forces against
    which it holds."""
    follows = before is not None and before.mode == now.mode == p.Mode.POSITION_PROFILE
    return follows and before is not None and now.contacts != before.contacts


def _servos(chains: Sequence[Observation]) -> dict[str, tuple[float, ...]]:
    """Return the sensor values of the servos, in the order of all axes. An axis without a servo has NaN."""
    rows = {}
    for name in SERVO_ROWS:
        parts = [chain.sensors.get(name, (math.nan,) * len(chain.position)) for chain in chains]
        rows[name] = (math.nan, math.nan, *(value for part in parts for value in part), math.nan, math.nan)
    return rows
