"""Test the registers: the manual's own examples, and every bit there and back."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from strands_actors.drivers.robotiq import protocol as p

byte = st.integers(0, 255)
commands = st.builds(p.Command, st.booleans(), st.booleans(), byte, byte, byte, st.booleans())
statuses = st.builds(
    p.Status,
    st.booleans(),
    st.booleans(),
    st.integers(0, 3),
    st.integers(0, 3),
    st.integers(0, 15),
    byte,
    byte,
    byte,
)

HOLD = p.Command(position=7)


def test_the_manuals_examples() -> None:
    full = p.Command(go_to=True, position=255)
    assert full.registers() == [0x0900, 0x00FF, 0xFFFF]
    assert p.Status.from_registers([0x1100, 0, 0]).activation == p.Activation.ACTIVATING
    assert p.Status.from_registers([0x3100, 0, 0]).active
    gripped = p.Status.from_registers([0xB900, 0x00FF, 0xBD00])
    assert gripped == p.Status(True, True, p.Activation.ACTIVE, p.Contact.CLOSING, 0, 255, 0xBD, 0)
    opened = p.Status.from_registers([0xF900, 0x0000, 0x0D00])
    assert (opened.contact, opened.position) == (p.Contact.ARRIVED, 13)


@given(commands)
def test_a_command_comes_back_as_it_was(command: p.Command) -> None:
    assert p.Command.from_registers(command.registers()) == command


@given(statuses)
def test_a_status_comes_back_as_it_was(status: p.Status) -> None:
    assert p.Status.from_registers(status.registers()) == status


@given(st.lists(st.integers(0, 0xFFFF), min_size=3, max_size=3))
def test_any_status_of_a_gripper_can_be_decoded(registers: list[int]) -> None:
    status = p.Status.from_registers(registers)
    assert p.fault_words(status.fault)
    p.Contact(status.contact)


def test_the_controllers_fault_is_not_the_grippers() -> None:
    assert p.Status.from_registers([0x3100, 0x5000, 0]).fault == 0


@given(statuses)
def test_a_safe_command_neither_goes_nor_opens_nor_activates(status: p.Status) -> None:
    command = p.safe_command(status)
    assert not command.go_to and not command.release
    if not status.activated or status.activation == p.Activation.ACTIVATING:
        assert not command.activate, "a rising rACT moves the fingers, and only a reset ends an activation"
    else:
        assert command == p.Command(position=command.position), "the gripper keeps its grip"
        assert abs(command.position - status.position) <= 1 and 0 <= command.position <= p.TOP
        assert command.position != status.request, "another position than before, so that its echo is new"


@pytest.mark.parametrize(
    ("status", "command", "says"),
    [
        (p.Status(True, True, 3, request=7), HOLD, "fingers still move"),
        (p.Status(True, False, 1, request=7), HOLD, "activating"),
        (p.Status(True, False, 3, request=7, fault=0x0B), HOLD, "the fingers open"),
        (
            p.Status(True, False, 3, request=6),
            HOLD,
            "the gripper has not confirmed the hold (sent 7, it repeats 6)",
        ),
        (p.Status(False, False, 0, request=7), HOLD, "no longer activated"),
        (p.Status(True, False, 3, request=7), HOLD, ""),
        (p.Status(True, False, 3), p.RESET, "the gripper has not carried out the reset"),
        (p.Status(True, False, 1), p.RESET, "activating"),
        (p.Status(False, False, 0, request=7), p.RESET, ""),
    ],
)
def test_the_reason_for_an_unsafe_report_is_named(status: p.Status, command: p.Command, says: str) -> None:
    words = p.unsafe_words(status, command)
    assert says in words and bool(says) == bool(words)


@pytest.mark.parametrize(
    ("command", "active", "kind"),
    [
        (p.Command(go_to=True), True, "setpoint"),
        (p.Command(release=True), True, "setpoint"),
        (p.ACTIVATE, False, "enable"),
        (p.Command(position=7), True, "safe"),
        (p.RESET, True, "safe"),
        (p.RESET, False, "safe"),
    ],
)
def test_a_hold_differs_from_an_activation(command: p.Command, active: bool, kind: str) -> None:
    assert p.classify(command, active) == kind
