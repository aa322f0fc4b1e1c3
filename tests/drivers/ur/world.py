"""The twin's controller with ur-rtde's control script, on a clock that the test controls."""

from __future__ import annotations

from collections.abc import Sequence

from strands_actors.drivers.ur import protocol as p
from strands_actors.drivers.ur.arms import arm_of
from strands_actors.drivers.ur.twin import commands as c
from strands_actors.drivers.ur.twin.controller import Controller
from strands_actors.drivers.ur.twin.outputs import Sample
from strands_actors.drivers.ur.twin.script import program_of, run_text

SCRIPT = b"def rtde_control():\n    global reg_offset_int = # int register offset\n24\nend\n"
COMMAND = c.UPPER_RANGE
TICK_S = 0.002


class World:
    def __init__(self, robot: str = "ur5e") -> None:
        self.now_s = 100.0
        self.events: list[str] = []
        self.controller = Controller(
            arm_of(robot), now_s=lambda: self.now_s, on_event=lambda kind, text: self.events.append(kind)
        )

    def run(self, seconds: float, feed: bool = False) -> None:
        for _ in range(round(seconds / TICK_S)):
            self.now_s += TICK_S
            if feed:
                self.command(c.Command.NONE)
            self.controller.tick()

    def command(self, number: int, *doubles: float) -> None:
        values: dict[str, p.Value] = {f"input_int_register_{COMMAND}": number}
        values |= {f"input_double_register_{COMMAND + at}": value for at, value in enumerate(doubles)}
        self.controller.write(values)

    def ask(self, number: int, *doubles: float) -> tuple[float, ...]:
        """Return the script's answer to a command that computes: six numbers."""
        self.command(c.Command.NONE)
        self.command(number, *doubles)
        assert self.answer == c.DONE, self.controller.log
        return tuple(self.controller.double_out[COMMAND : COMMAND + 6])

    def agrees(self, number: int, *doubles: float) -> bool:
        self.ask(number, *doubles)
        return bool(self.controller.int_out[COMMAND + 1])

    def start(self) -> None:
        self.controller.start_program(program_of(SCRIPT, self.controller))
        self.run(0.1)
        assert self.controller.runtime_state == p.RuntimeState.PLAYING

    def text(self, text: str, seconds: float = 0.1) -> None:
        run_text(text.encode(), self.controller)
        self.run(seconds)

    def out(self, name: str) -> p.Value:
        return Sample(self.controller)[name]

    @property
    def answer(self) -> int:
        return self.controller.int_out[COMMAND]

    @property
    def pan(self) -> float:
        return self.joints[0]

    @property
    def joints(self) -> Sequence[float]:
        return self.controller.plant.position_rad

    @property
    def tool(self) -> tuple[float, ...]:
        return self.controller.tool().pose()
