"""Test our control script on the twin's controller, which interprets its text line by line. The test controls
the clock."""

from __future__ import annotations

from collections.abc import Iterable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from strands_actors.drivers.ur import protocol as p
from strands_actors.drivers.ur import script as s
from strands_actors.drivers.ur.arms import TABLES
from strands_actors.drivers.ur.gates import CONTROL_S, WATCHDOG_HZ
from strands_actors.drivers.ur.twin.commands import classify_command
from strands_actors.drivers.ur.twin.motion import Servo
from strands_actors.drivers.ur.twin.script import run_text

from .world import TICK_S, World

TOKEN, OTHER = 77, 78
LONGEST_STEP_S = CONTROL_S + 2 * TICK_S
"""The script's loop reads its registers at least this often."""


class Arm(World):
    """An arm on which our script runs."""

    def __init__(self, robot: str = "ur5e", *, token: int = TOKEN) -> None:
        super().__init__(robot)
        self.sequence = 0
        self.token = token
        self.tell(s.Order.KEEP)

    def tell(self, order: s.Order, *targets: float) -> None:
        self.sequence = s.next_number(self.sequence)
        goal = targets or (0.0,) * 6
        words: dict[str, p.Value] = dict(zip(s.TARGETS, goal, strict=True))
        self.controller.write({**words, s.ORDER: order, s.SEQUENCE: self.sequence, s.TOKEN: self.token})

    def upload(self, token: int = TOKEN) -> None:
        run_text(s.control_script(token), self.controller)
        self.run(self.controller.program_start_s + TICK_S)

    def ready(self) -> Arm:
        self.upload()
        assert self.answers == (TOKEN, s.Phase.WAITS, 0)
        self.tell(s.Order.KEEP)
        self.run(LONGEST_STEP_S)
        assert self.answers == (TOKEN, s.Phase.READY, self.sequence)
        return self

    def stream(self, order: s.Order, pans: Iterable[float]) -> None:
        """Send a packet in each control period. ``pans`` are the targets of the first joint."""
        others = self.joints[1:]
        for pan in pans:
            self.tell(order, pan, *others)
            self.run(CONTROL_S)

    def sweep(self) -> float:
        """Turn the first joint by 0.2 rad. Return the last target."""
        pans = [self.pan + 0.005 * step for step in range(1, 41)]
        self.stream(s.Order.SERVO, pans)
        return pans[-1]

    @property
    def answers(self) -> tuple[p.Value, ...]:
        return tuple(self.out(name) for name in s.ANSWERS)

    @property
    def servoes(self) -> bool:
        return isinstance(self.controller.motion, Servo)

    @property
    def runs(self) -> bool:
        return self.controller.runtime_state == p.RuntimeState.PLAYING


@pytest.mark.parametrize("robot", TABLES.robots)
def test_every_robot_follows_its_targets_and_holds(robot: str) -> None:
    arm = Arm(robot).ready()
    target = arm.sweep()
    assert arm.servoes
    assert abs(arm.pan - target) < 0.1
    arm.stream(s.Order.SERVO, [target] * 25)
    assert abs(arm.pan - target) < 0.005
    arm.stream(s.Order.HOLD, [9.0] * 2)
    assert not arm.servoes and arm.runs, "the values in the registers are no target any more"
    arm.stream(s.Order.KEEP, [9.0] * 50)
    assert abs(arm.pan - target) < 0.005
    assert arm.answers[2] == arm.sequence
    arm.sweep()
    assert arm.servoes, "the script continues without another upload"
    assert arm.events == ["stopj"]


def test_saf_013_a_setpoint_that_is_too_old_ends_in_stopj() -> None:
    arm = Arm().ready()
    arm.sweep()
    silent_s = s.SILENT_S - CONTROL_S  # one period has passed since the last packet
    arm.run(silent_s - 2 * LONGEST_STEP_S)
    assert arm.servoes, "the arm does not stop earlier"
    arm.run(2 * LONGEST_STEP_S + TICK_S)
    assert not arm.servoes
    assert arm.events == ["stopj"], "the script stopped the arm, not the controller's watchdog"
    arm.run(0.5)
    assert not arm.runs
    stood = arm.pan
    arm.sweep()
    assert not arm.servoes and abs(arm.pan - stood) < 1e-3, "no motion continues by itself"


def test_saf_013_the_controllers_watchdog_ends_a_script_that_does_not_count(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A speed slider near 0 slows servoj down, and with it the script's count."""
    monkeypatch.setattr(s, "SILENT_S", 60.0)
    arm = Arm().ready()
    arm.sweep()
    arm.run(1 / WATCHDOG_HZ - CONTROL_S - TICK_S)
    assert arm.runs and not arm.events
    arm.run(3 * TICK_S)
    assert arm.events == ["watchdog"]
    assert not arm.runs and not arm.servoes


def test_saf_013_a_hold_is_kept_only_as_long_as_it_is_fed() -> None:
    arm = Arm().ready()
    arm.stream(s.Order.KEEP, [0.0] * 60)
    assert arm.runs
    arm.run(s.SILENT_S + 2 * LONGEST_STEP_S)
    assert not arm.runs


@pytest.mark.parametrize("token", [TOKEN, OTHER])
def test_saf_021_a_script_that_starts_late_ignores_earlier_commands(token: int) -> None:
    """Registers keep the last values of a connection that has ended."""
    arm = Arm(token=token)
    arm.tell(s.Order.SERVO, 3.0, *arm.joints[1:])
    stood = list(arm.joints)
    arm.upload()
    arm.run(s.FIRST_WORD_S / 2)
    assert arm.runs and not arm.servoes
    arm.run(s.FIRST_WORD_S)
    assert not arm.runs
    assert max(abs(rad - was) for rad, was in zip(arm.joints, stood, strict=True)) < 1e-3


def test_saf_021_a_script_obeys_no_other_upload() -> None:
    arm = Arm().ready()
    arm.sweep()
    arm.token = OTHER
    arm.stream(s.Order.SERVO, [arm.pan + 0.1] * 2)
    assert not arm.servoes
    arm.stream(s.Order.SERVO, [arm.pan + 0.1] * 50)
    assert not arm.runs


def test_saf_010_an_order_to_end_stops_the_arm_and_ends_the_script() -> None:
    arm = Arm().ready()
    arm.sweep()
    arm.tell(s.Order.END)
    arm.run(LONGEST_STEP_S)
    assert not arm.servoes
    arm.stream(s.Order.END, [0.0] * 40)  # feeds the watchdog while the arm brakes
    assert not arm.runs and arm.events == ["stopj"]
    assert arm.answers == (TOKEN, s.Phase.ENDED, 2), "the answer to the last hold does not count for this order"


def test_a_missing_function_of_the_controller_is_named() -> None:
    arm = Arm()
    run_text(s.control_script(TOKEN).replace(b"servoj", b"servox"), arm.controller)
    arm.run(0.1)
    arm.tell(s.Order.KEEP)
    arm.run(LONGEST_STEP_S)
    arm.tell(s.Order.SERVO, *arm.joints)
    arm.run(LONGEST_STEP_S)
    assert not arm.runs
    assert "servox is not available" in arm.controller.log[-1]


def test_the_wire_log_reads_its_orders() -> None:
    kinds = {order.name: classify_command(order) for order in s.Order}
    assert kinds == {"KEEP": "keepalive", "SERVO": "setpoint", "HOLD": "safe", "END": "safe"}


@given(st.integers(1, s.LAST_NUMBER), st.integers(0, 1000))
def test_sequence_numbers_go_on_for_ever(number: int, steps: int) -> None:
    later = number
    for _ in range(steps):
        later = s.next_number(later)
        assert 1 <= later <= s.LAST_NUMBER
    assert s.has_reached(later, number)
    assert not steps or not s.has_reached(number, later)
    assert not s.has_reached(0, number)
