"""Ask the user for something by hand at a terminal, and show values while it is done."""

from __future__ import annotations

import select
import sys
from typing import Any

import trio

from strands_actors.contract.loading import load
from strands_actors.surfaces.drill.certificate import StepResult

from .errors import Problem

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

    def instruct(self, text: str) -> None:
        """Print an instruction, also if the output is otherwise JSON."""
        print(f"  >> {text}", file=sys.stderr, flush=True)

    def step(self, result: StepResult) -> None:
        """Print the result of one step of a drill."""
        self.say(f"  {result.step:<12} {'ok' if result.passed else 'FAILED'}")

    def consents(self, text: str, word: str) -> bool:
        """Print what will happen, and return True if the user types this word. Raise ``Problem`` without a
        terminal."""
        print(text, file=sys.stderr)
        if not sys.stdin.isatty():
            raise Problem("drill: consent needs a terminal. Run this in a terminal, or pass --yes if you consent")
        print(f"Type {word} to go on: ", end="", file=sys.stderr, flush=True)
        return sys.stdin.readline().strip() == word

    def show(self, sweep: Any, joint: str, expected: int | None) -> None:
        """Print how far a joint was moved, over the previous output. Do nothing if stderr is not a terminal."""
        if not self._redraws:
            return
        up = "\x1b[1A" if self._is_shown else ""
        goal = "" if expected is None else f" of about {expected * DEGREES_PER_COUNT:.0f}"
        print(f"{up}\x1b[K{joint:16} {sweep.moved(joint) * DEGREES_PER_COUNT:6.1f}{goal} degrees", file=sys.stderr)
        self._is_shown = True
