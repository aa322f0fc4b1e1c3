"""Ask the user for something by hand at a terminal, and show values while it is done."""

from __future__ import annotations

import select
import sys
from typing import Any

import trio

from strands_actors.contract.loading import load

TURN_S = 0.05
DEGREES_PER_COUNT = 360 / 4096
TEXT_OF = "strands_actors.drivers.common.servo.findings:text_of"
YES = "yes"


class Terminal:
    """Prints instructions for the user, and waits until the user presses Enter."""

    def __init__(self, quiet: bool) -> None:
        self._quiet = quiet
        self._redraws = sys.stderr.isatty() and not quiet
        self._is_shown = False

    def say(self, text: str) -> None:
        if not self._quiet:
            print(text, file=sys.stderr, flush=True)

    async def ready(self, text: str) -> None:
        """Print an instruction, and wait for Enter."""
        self.say(f"{text}, then press Enter")
        self._is_shown = False
        await self._line()

    async def confirm(self, proposal: Any) -> bool:
        """Print the result of a calibration, and return True if the user types "yes"."""
        self.say(f"{'joint':16} {'swept':>8} {'offset':>14} {'range':>12}")
        for key, motor in proposal.motors.items():
            swept = f"{proposal.counts[key] * DEGREES_PER_COUNT:.1f} deg" if key in proposal.counts else ""
            offset = f"{proposal.before[key]['homing_offset']} -> {motor.homing_offset}"
            self.say(f"{key:16} {swept:>8} {offset:>14} {f'{motor.range_min}-{motor.range_max}':>12}")
        for finding in proposal.findings:
            self.say(f"{load(TEXT_OF)(finding)}.")
        self.say("Nothing was written yet. Type yes and press Enter to write these values into the servos")
        return (await self._line()).strip() == YES

    async def _line(self) -> str:
        while True:
            readable, _, _ = select.select([sys.stdin], [], [], 0)
            if readable:
                line = sys.stdin.readline()
                if not line:
                    raise ValueError(
                        "standard input has ended, so Enter cannot be pressed. Run this command in a terminal"
                    )
                return line
            await trio.sleep(TURN_S)

    def show(self, sweep: Any, joint: str) -> None:
        """Print how far a joint was moved, over the previous output. Do nothing if stderr is not a terminal."""
        if not self._redraws:
            return
        up = "\x1b[1A" if self._is_shown else ""
        print(f"{up}\x1b[K{joint:16} {sweep.moved(joint) * DEGREES_PER_COUNT:6.1f} degrees", file=sys.stderr)
        self._is_shown = True
