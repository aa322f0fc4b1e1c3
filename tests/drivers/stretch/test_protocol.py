"""Test the calls and replies of the boards, with each version of their layout."""

from __future__ import annotations

import contextlib
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.drivers.stretch import protocol as p
from strands_actors.drivers.stretch.parameters import parameters_of

floats = st.floats(-1e6, 1e6, width=32)
PARAMETERS = parameters_of("stretch3")


def test_sizes_are_those_of_the_firmware() -> None:
    assert p.COMMAND_BYTES == struct.calcsize("<BfffffffB") == 30
    assert [p.stepper_status_bytes(protocol) for protocol in (1, 3, 4, 5)] == [47, 47, 51, 51]
    assert [p.pimu_status_bytes(protocol) for protocol in (1, 3, 4, 6)] == [114, 114, 118, 119]
    assert [p.gains_bytes(protocol) for protocol in (1, 3, 5)] == [81, 81, 85]
    assert p.WACC_STATUS_BYTES == 38


@given(st.tuples(st.integers(0, 9), *[floats] * 7, st.integers(0, 254)))
def test_a_command_is_read_back(fields: tuple[float, ...]) -> None:
    command = p.Command(*fields)  # type: ignore[arg-type]
    call = command.call()
    assert call[0] == p.COMMAND
    assert p.parse_command(call[1:]) == command


@pytest.mark.parametrize(
    ("command", "kind"),
    [
        (p.Command(p.Mode.HOLD), "safe"),
        (p.Command(p.Mode.SAFETY), "safe"),
        (p.Command(p.Mode.FREEWHEEL), "safe"),
        (p.Command(p.Mode.VELOCITY), "safe"),
        (p.Command(p.Mode.VELOCITY, velocity=0.1), "setpoint"),
        (p.Command(p.Mode.VELOCITY_PROFILE), "setpoint"),
        (p.Command(p.Mode.POSITION_PROFILE), "setpoint"),
        (p.Command(p.Mode.CURRENT), "setpoint"),
    ],
)
def test_a_stop_differs_from_a_setpoint_of_zero(command: p.Command, kind: str) -> None:
    assert command.kind == kind


@pytest.mark.parametrize("protocol", [1, 3, 4, 5])
def test_a_steppers_status(protocol: int) -> None:
    voltage = 630.0 if protocol >= 4 else 0.0
    status = p.StepperStatus(5, 0.5, 12.25, -1.5, 0.25, 0x105, 1 << 40, 0.0, 2, 0.0, 7, voltage)
    data = p.pack_stepper_status(status, protocol)
    assert p.parse_stepper_status(data) == status
    assert status.has(p.Diag.HOMED) and not status.has(p.Diag.RUNSTOP)


@pytest.mark.parametrize("number", [float("nan"), float("inf")])
def test_a_status_with_an_invalid_number_is_refused(number: float) -> None:
    status = p.StepperStatus(5, 0.0, number, 0.0, 0.0, 0, 0, 0.0, 0, 0.0, 0, 0.0)
    with pytest.raises(MalformedFrame, match="a number that is not finite"):
        p.parse_stepper_status(p.pack_stepper_status(status, 5))


def test_a_power_boards_status_with_fields_of_newer_firmware() -> None:
    status = p.PimuStatus(
        (0.5, 1.0, 9.75), (0.25, 0.0, 0.0), (1.0, 2.0, 3.0), (10.0, 20.0, 350.0), (1.0, 0.0, 0.0, 0.0), 0.5,
        655.0, 170.0, 300.0, (1.0, 2.0, 3.0, 4.0), p.State.RUNSTOP | p.State.CHARGER, 123456789, 3, 0.5,
    )  # fmt: skip
    for protocol in p.PROTOCOLS[p.Kind.PIMU]:
        assert p.parse_pimu_status(p.pack_pimu_status(status, protocol)) == status
    assert status.voltage_v == pytest.approx(12.79, abs=0.01)
    assert status.current_a(3) == pytest.approx(2.446, abs=0.001)
    assert status.current_a(0) == pytest.approx(1.343, abs=0.001)


def test_gains_leave_sync_mode_out_and_keep_the_wheels_watchdog() -> None:
    wheel, lift = PARAMETERS.left.gains, PARAMETERS.lift.gains
    assert wheel.config & p.Config.VELOCITY_WATCHDOG and not lift.config & p.Config.VELOCITY_WATCHDOG
    assert not (wheel.config | lift.config) & p.Config.SYNC, "commands take effect when they arrive"
    assert lift.config & p.Config.SAFETY_HOLD and not wheel.config & p.Config.SAFETY_HOLD
    assert wheel.config & lift.config & p.Config.RUNSTOP
    read = p.parse_gains(wheel.pack(5))
    assert read.values == pytest.approx(wheel.values) and read.config == wheel.config
    assert p.parse_gains(wheel.pack(3)).config == wheel.config


def test_a_configuration_of_the_power_board() -> None:
    call = p.pimu_config_call(PARAMETERS.pimu_config)
    assert call[0] == p.PIMU_CONFIG and len(call) == 130
    assert p.stops_at_runstop(call[1:])
    without = [0.0 if at == 10 else value for at, value in enumerate(PARAMETERS.pimu_config)]
    assert not p.stops_at_runstop(p.pimu_config_call(without)[1:])


def test_the_identity_of_a_board() -> None:
    info = p.parse_board_info(p.board_info_reply("Stepper.3", "Stepper.v0.7.2p5", 4))
    assert (info.kind, info.version, info.protocol, info.hardware) == ("Stepper", (0, 7), 5, 3)
    old = p.parse_board_info(p.board_info_reply("Stepper.Irma.V1", "Stepper.v0.5.1p1"))
    assert (old.protocol, old.hardware) == (1, 0)


@pytest.mark.parametrize("data", [b"", bytes(39), bytes(42), b"Stepper.3".ljust(40, b"\0"), b"\xff" * 40])
def test_an_invalid_name_is_refused(data: bytes) -> None:
    with pytest.raises(MalformedFrame):
        p.parse_board_info(data)


@given(st.binary(max_size=150))
def test_any_bytes_are_decoded_or_raise_the_codecs_error(data: bytes) -> None:
    for parse in (
        p.parse_command, p.parse_stepper_status, p.parse_pimu_status, p.parse_gains, p.parse_trigger,
        p.parse_motion_limits, p.parse_pimu_trigger, p.parse_board_info, p.stops_at_runstop,
    ):  # fmt: skip
        with contextlib.suppress(MalformedFrame):
            parse(data)
