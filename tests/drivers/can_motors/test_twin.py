"""Drive the twin, a process behind a pseudo-terminal, with unchanged clients: motorbridge and python-can."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import can
import pytest
from motorbridge import Controller, Mode

from strands_actors.drivers.can_motors.protocol import Damiao, State
from strands_actors.drivers.can_motors.robots import arm_of, table_of
from strands_actors.drivers.can_motors.twin import CanRobot
from strands_actors.testing import Twin
from tests.answers import until

MODELS = ("4340P",) * 3 + ("4310",) * 4


@pytest.fixture
def twin(tmp_path: Path) -> Iterator[Twin]:
    with Twin("rebot_b601", tmp_path) as process:
        yield process


def test_motorbridge_drives_an_arm_over_damiaos_adapter(twin: Twin) -> None:
    controller = Controller.from_dm_serial(twin.port, 921_600)
    motors = [controller.add_damiao_motor(number, number + 16, model) for number, model in enumerate(MODELS, 1)]
    assert [round(motor.get_register_f32(21), 3) for motor in motors] == [12.5] * 7
    for motor in motors:
        motor.ensure_mode(Mode.MIT)
    motors[0].set_can_timeout_ms(100)
    assert motors[0].get_register_u32(Damiao.TIMEOUT) == 2000
    motors[0].set_can_timeout_ms(0)
    controller.enable_all()

    def states() -> list[Any]:
        for number, motor in enumerate(motors):
            stiff = number < 3
            motor.send_mit(0.0 if number else 0.3, 0.0, 45.0 if stiff else 8.0, 3.0 if stiff else 1.0, 0.0)
        controller.poll_feedback_once()
        return [motor.get_state() for motor in motors]

    until(lambda: abs(states()[0].pos - 0.3) < 0.05, "the first joint has arrived")
    assert {state.status_code for state in states()} == {State.ENABLED}

    def disabled() -> bool:
        for motor in motors:
            motor.disable()
        controller.poll_feedback_once()
        return {motor.get_state().status_code for motor in motors} == {State.DISABLED}

    until(disabled, "all motors are disabled")
    controller.close()
    assert {"setpoint", "enable", "safe", "config"} <= {entry.kind for entry in twin.log.entries()}


def test_python_can_reads_a_register_over_slcan(twin: Twin) -> None:
    with can.Bus(interface="slcan", channel=twin.port, bitrate=1_000_000, sleep_after_open=0) as bus:

        def ask(number: int, data: str) -> can.Message | None:
            bus.send(can.Message(arbitration_id=number, data=bytes.fromhex(data), is_extended_id=False))
            for _ in range(20):  # the adapter also answers its own commands
                if (message := bus.recv(1.0)) is not None:
                    return message
            return None

        limit = ask(0x7FF, "0300331500000000")
        assert limit is not None
        assert (limit.arbitration_id, bytes(limit.data).hex()) == (0x13, "0300331500004841")
        enabled = ask(0x03, "fffffffffffffffc")
        assert enabled is not None
        assert enabled.data[0] >> 4 == State.ENABLED
        assert bus.recv(0.05) is None, "nothing comes that was not asked for"


def test_the_twin_switches_its_motors_off_after_their_timeout(tmp_path: Path) -> None:
    now = [0.0]
    table = table_of("rebot_b601")
    robot = CanRobot(arm_of("rebot_b601", table), table, lambda: now[0])
    codec = robot.arm.motors[1].codec()
    for frame in (codec.write(Damiao.TIMEOUT, 4000), codec.enable()):
        robot.handle(0, frame)
    now[0] = 0.15
    robot.handle(0, codec.ask())

    def state() -> State:
        robot.pass_time()
        return robot.motors[1].state

    now[0] = 0.3
    assert state() is State.ENABLED, "every frame to the motor counts"
    now[0] = 0.4
    lost = State.LOST_COMMUNICATION
    assert state() is lost
    robot.handle(0, codec.enable())
    assert state() is lost, "a latched fault must be cleared first"
    robot.handle(0, codec.clear())
    robot.handle(0, codec.enable())
    assert state() is State.ENABLED
