"""How fast can six Feetech servos be read and written, compared with the vendor's SDK and lerobot's bus?"""

from __future__ import annotations

from .house import Figures, Goal, Question, Side
from .stage import at_line


def side(robot: str, who: str, peer: str = "") -> Side:
    def ask(short: bool) -> Figures:
        return at_line(robot, "bus", who, "short" if short else "long", robot, peer=peer)

    return ask


LIMIT = """The bytes need {bytes} µs a cycle at 1 Mbaud. `floor` is the best that this machine allows: the same
bytes, made in advance, through a blocking descriptor. The kernel takes two thirds of our processor time, in the
`write` of a pseudo terminal (`SerialPort.write` in the flame graph); encoding and decoding are 20 µs a cycle.

Above the floor we add mostly one wake-up of trio's loop per answer. `floor in a loop of trio` has that, too,
because a loop that serves stops meanwhile cannot block in `read`. The vendor's SDK blocks in `read`, and is
between them. `our wire` is the cycle of one of our robots: it reads {whole}, so its own limit is {own} Hz. It is
read at the control rate, not as fast as possible."""

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
    limit=LIMIT.format(
        bytes=880, whole="position, velocity, load, voltage and temperature, 8 bytes a servo", own=806
    )
    + """ The goal would leave 2 to 13 µs of a cycle beyond `floor in a loop of trio`, which reached 0.902 and
0.912 in two runs. In that time our side would have to do all that the floor omits: give up on a late answer,
check sums, decode, compare and encode. With all that, ours is 25 to 40 µs behind it.""",
    ground="floor in a loop of trio",
    rounds=2,
)
