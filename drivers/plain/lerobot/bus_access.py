"""Read and write the servos of one of LeRobot's buses: everything that this package uses of such a bus.

LeRobot has replaced the libraries below its buses once, and may do so again. So this module calls only the methods
that LeRobot's own robots call. It asks neither for the library's objects nor for the version of its protocol.
"""

from __future__ import annotations

import contextlib
import termios
import time
from collections.abc import Iterator, Sequence
from typing import Any

GOAL, PRESENT, TORQUE = "Goal_Position", "Present_Position", "Torque_Enable"
"""Register names of LeRobot."""
LOOKS, LOOK_S = 4, 0.03
"""How often the torque is read back, and the pause in between in seconds, so that late answers arrive."""
TRIES = 2
"""Number of retries after a bad answer, within the timeout of the call."""


def read(bus: Any, register: str, motors: Sequence[str] | None = None) -> dict[str, int]:
    """Return the raw value of a register of each motor.

    Args:
        bus: The bus.
        register: LeRobot's name of the register.
        motors: The motors; None for all motors of the bus.

    Raises:
        ConnectionError: A motor has not answered.
    """
    try:
        values: dict[str, int] = bus.sync_read(register, motors, num_retry=TRIES, normalize=False)
    except NotImplementedError:
        # Feetech's first protocol version has no frame that reads all motors.
        return {
            motor: bus.read(register, motor, num_retry=TRIES, normalize=False) for motor in motors or bus.motors
        }
    return values


def torque_off(bus: Any, ports: Sequence[int]) -> None:
    """Send the frame that switches off the torque of all motors of a bus. No motor answers it.

    Args:
        bus: The bus.
        ports: The descriptors of the robot's serial ports.
    """
    discard_input(ports)
    bus.sync_write(TORQUE, dict.fromkeys(bus.motors, 0), normalize=False)


def require_limp(bus: Any, ports: Sequence[int], agreeing: int = 1) -> None:
    """Read the torque of all motors, several times if necessary.

    Args:
        bus: The bus.
        ports: The descriptors of the robot's serial ports.
        agreeing: The number of readings in a row that must show no torque.

    Raises:
        ConnectionError: A motor may have torque.
    """
    limp_readings, reason = 0, ""
    for look in range(LOOKS):
        if look:
            time.sleep(LOOK_S)
        discard_input(ports)
        try:
            energised = [motor for motor, value in read(bus, TORQUE).items() if value]
        except ConnectionError as error:
            energised, reason = list(bus.motors), str(error)
        else:
            if energised:
                reason = f"{', '.join(energised)} still has torque"
        limp_readings = 0 if energised else limp_readings + 1
        if limp_readings == agreeing:
            return
    raise ConnectionError(reason)


def discard_input(ports: Sequence[int]) -> None:
    """Discard the bytes that were received, since LeRobot would take a late reply for the reply to its next
    request. A port that was unplugged has none.

    Args:
        ports: The descriptors of the robot's serial ports.
    """
    for descriptor in ports:
        with contextlib.suppress(termios.error):
            termios.tcflush(descriptor, termios.TCIFLUSH)


@contextlib.contextmanager
def without_torque(bus: Any) -> Iterator[None]:
    """Keep the torque off while LeRobot configures the motors. LeRobot would switch it on at the end, and the
    motors would move to the goals of an earlier session."""
    # An attribute of this object replaces the method of its class.
    bus.enable_torque = lambda *args, **keywords: None
    try:
        yield
        bus.disable_torque(num_retry=TRIES)  # the torque may already be on from an earlier session
    finally:
        del bus.enable_torque
