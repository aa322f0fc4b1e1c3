"""Hello Robot's stretch_body in a separate environment. It drives the lift's board."""

from __future__ import annotations

import contextlib
import os
import sys
import time
from pathlib import Path

from .hand import Hand, wave

STEP_M = 0.02


class Client(Hand):
    """The client. Its stop is the motor's hold."""

    def __init__(self, robot: str, port: str) -> None:
        fleet = Path(port).parent / "fleet"
        (known,) = fleet.iterdir()
        os.environ["HELLO_FLEET_PATH"], os.environ["HELLO_FLEET_ID"] = str(fleet), known.name
        os.environ["HOME"] = str(fleet.parent)  # for its log
        with contextlib.redirect_stdout(sys.stderr):
            import stretch_body.lift  # it reads these variables when imported

            self._lift = stretch_body.lift.Lift()
            if not self._lift.startup(threaded=False):
                raise RuntimeError("the lift does not start")
            self._lift.pull_status()
            self._here = self._lift.status["pos"]
            self._lift.motor.disable_sync_mode()
            self._lift.push_command()

    def setpoint(self, number: int) -> int:
        began_ns = time.monotonic_ns()
        self._lift.move_to(self._here + STEP_M * wave(number))
        self._lift.push_command()
        return began_ns

    def stop(self) -> None:
        self._lift.motor.enable_hold()
        self._lift.push_command()
