"""The client for a Stretch: Hello Robot's stretch_body, in a separate environment. It commands only the lift."""

from __future__ import annotations

import contextlib
import os
import sys
import time
from pathlib import Path

from .hand import BaseClient, wave

STEP_M = 0.02


class Client(BaseClient):
    """The client. Its stop makes the motor hold its position."""

    def __init__(self, robot: str, port: str) -> None:
        fleet = Path(port).parent / "fleet"
        (robot_folder,) = fleet.iterdir()
        os.environ["HELLO_FLEET_PATH"], os.environ["HELLO_FLEET_ID"] = str(fleet), robot_folder.name
        # stretch_body writes its log into the home directory.
        os.environ["HOME"] = str(fleet.parent)
        with contextlib.redirect_stdout(sys.stderr):
            # The module reads the environment variables above when it is imported.
            import stretch_body.lift

            self._lift = stretch_body.lift.Lift()
            if not self._lift.startup(threaded=False):
                raise RuntimeError("the board of the lift does not answer")
            self._lift.pull_status()
            self._base = self._lift.status["pos"]
            self._lift.motor.disable_sync_mode()
            self._lift.push_command()

    def setpoint(self, number: int) -> int:
        began_ns = time.monotonic_ns()
        self._lift.move_to(self._base + STEP_M * wave(number))
        self._lift.push_command()
        return began_ns

    def stop(self) -> None:
        self._lift.motor.enable_hold()
        self._lift.push_command()
