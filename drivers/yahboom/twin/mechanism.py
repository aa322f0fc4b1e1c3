"""Simulate the robot: a base that moves in the plane and has the firmware's watchdog, and six
servos that follow their goals."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from strands_actors.drivers.common.physics.body import Commander
from strands_actors.drivers.common.physics.stepped import PlanarBase, towards
from strands_actors.drivers.yahboom.messages import REST, ArmGoal, Odometry, Twist
from strands_actors.drivers.yahboom.robots import M3Pro


class Mechanism(PlanarBase):
    """The simulated robot. Its firmware stops the base after ``watchdog_s`` seconds without a
    command; with 0 it never does."""

    STEP_S = 0.005

    def __init__(self, table: M3Pro, watchdog_s: float, now_s: Callable[[], float]) -> None:
        self._table = table
        super().__init__(watchdog_s, now_s)
        self.reset()

    def reset(self) -> None:
        """Put the robot back at its start, at rest, with the arm in its home pose."""
        self.commander = self.arm_commander = Commander.NONE
        self.commanded = REST
        self.runs = REST  # present speed of the base
        self.x_m = self.y_m = self.yaw_rad = 0.0
        self.degrees = [float(value) for value in self._table.home_deg]
        self._goal = list(self.degrees)
        self._speed_deg_s = [0.0] * len(self.degrees)
        self.stuck = False
        self._commanded_s = self.now_s()

    def drive(self, twist: Twist, commander: Commander) -> None:
        """Set the speed of the base, for a client or for a local simulation."""
        self.pass_time()
        table = self._table
        fastest = (table.max_m_s, table.max_m_s, table.max_rad_s)
        self.commanded = Twist(*(min(max(value, -most), most) for value, most in zip(twist, fastest, strict=True)))
        self.commander = commander
        self._commanded_s = self.now_s()

    def move_arm(self, goal: ArmGoal, commander: Commander) -> None:
        """Set the goal of the arm. A goal outside a servo's range becomes the nearest limit."""
        self.aim_arm(goal.degrees, goal.time_ms / 1e3, commander)

    def aim_arm(self, degrees: Sequence[float], within_s: float, commander: Commander) -> None:
        self.pass_time()
        self.arm_commander = commander
        fastest = self._table.servo_deg_s
        for index, (servo, goal) in enumerate(zip(self._table.servos, degrees, strict=True)):
            self._goal[index] = min(max(goal, servo.low_deg), servo.high_deg)
            distance = abs(self._goal[index] - self.degrees[index])
            self._speed_deg_s[index] = min(fastest, distance / within_s if within_s > 0 else fastest)

    def hold_arm(self) -> None:
        self._goal = list(self.degrees)

    def pass_time(self) -> None:
        if self.is_overdue:
            self.commanded, self.commander = REST, Commander.NONE
        super().pass_time()

    def odometry(self) -> Odometry:
        """Return the present odometry of the wheels."""
        return Odometry(round(self.time_s * 1e9), self.x_m, self.y_m, self.yaw_rad, self.runs)

    def _step(self, step_s: float) -> None:
        goals = REST if self.stuck else self.commanded
        table = self._table
        ramps = (table.ramp_m_s2, table.ramp_m_s2, table.ramp_rad_s2)
        changes = zip(self.runs, goals, ramps, strict=True)
        self.runs = Twist(*(towards(run, goal, ramp * step_s) for run, goal, ramp in changes))
        self._roll(*self.runs, step_s)
        if not self.stuck:
            for index, goal in enumerate(self._goal):
                self.degrees[index] = towards(self.degrees[index], goal, self._speed_deg_s[index] * step_s)
