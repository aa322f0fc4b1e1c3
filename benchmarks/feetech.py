"""How fast can six Feetech servos be read and written, compared with the vendor's SDK and lerobot's bus?"""

from __future__ import annotations

from .house import Figures, Goal, Question, Side
from .stage import run_with_line


def side(robot: str, program: str, peer: str = "") -> Side:
    def ask(short: bool) -> Figures:
        return run_with_line(robot, "bus", program, "short" if short else "long", robot, peer=peer)

    return ask


LIMIT = """The bytes of a cycle, which reads six servos and writes six, need {bytes} µs at 1 Mbaud. `floor` is the
best that this computer allows: the same bytes, encoded beforehand, are written and read with blocking calls. The
kernel takes two thirds of our processor time, in the `write` to a pseudo-terminal (`SerialPort.write` in the flame
graph). Encoding and decoding take 20 µs per cycle.

Compared with `floor`, this package adds mostly one wake-up of trio's loop for each reply. `floor in a loop of
trio` also has one wake-up of trio's loop for each reply, because a loop that must also serve stops cannot block in
`read`. The vendor's SDK blocks in `read`, as `floor` does. `our wire` is the full cycle of one of our robots,
which reads {whole}, so the bus limits this full cycle to {own} Hz. A robot runs its full cycle at its control
rate, not as fast as possible."""

QUESTION = Question(
    name="feetech",
    title="Feetech: read six servos and write six, at 1 Mbaud",
    sides={
        "ours": side("so101", "ours"),
        "our wire": side("so101", "wire"),
        "feetech-servo-sdk": side("so101", "sdk"),
        "lerobot": side("so101", "lerobot", "lerobot"),
        "floor": side("so101", "floor"),
        "floor in a loop of trio": side("so101", "loop"),
    },
    goals=(
        Goal("of_limit_x", "", at_least=0.90),
        Goal("cpu_us", "feetech-servo-sdk", at_most=0.3),
    ),
    notice="""The arm is read and commanded as often as with LeRobot, but the processor stays free: 7 % of a
core are in use, not 96 %. On a small computer this is the difference between one arm and several.""",
    limit=LIMIT.format(
        bytes=880, whole="position, velocity, load, voltage and temperature, 8 bytes a servo", own=806
    )
    + """ `floor in a loop of trio` reached 0.902 and 0.912 of the bus's limit in two runs. To reach the goal of
0.900, a cycle of this package may take only 2 to 13 µs longer than one of `floor in a loop of trio`. In these 2 to
13 µs this package would have to do all the work that `floor` omits: timeouts, checksums, decoding, comparing and
encoding. With all this work, a cycle of this package takes 25 to 40 µs longer than one of `floor in a loop of
trio`.""",
    ground="floor in a loop of trio",
    rounds=2,
)
