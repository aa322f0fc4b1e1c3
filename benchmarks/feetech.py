"""How fast can six Feetech servos be read and written, compared with the vendor's SDK and lerobot's bus?"""

from __future__ import annotations

from .house import Figures, Goal, Question, Side
from .stage import at_line


def side(robot: str, who: str, peer: str = "") -> Side:
    def ask(short: bool) -> Figures:
        return at_line(robot, "bus", who, "short" if short else "long", robot, peer=peer)

    return ask


LIMIT = """The bytes need {bytes} µs a cycle at 1 Mbaud. `floor` is what this machine leaves of that: the same
bytes, made in advance, through a blocking descriptor. Two thirds of our processor time are the kernel's, in the
`write` of a pseudo terminal (`SerialPort.write` in the flame graph); encoding and decoding are 20 µs a cycle.
What we add to the floor is mostly one wake-up of trio's loop per answer, which `floor in a loop of trio` has, too:
a loop that serves stops meanwhile cannot block in `read`. The vendor's SDK, which does, stands between. `our
wire` is what a robot of ours does in every cycle: it reads {whole}, so its own limit is {own} Hz, and is asked at
the control rate, not flat out."""

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
    + """ The goal would leave 2 to 13 µs of a cycle beyond `floor in a loop of trio`, which was at 0.902 and at
0.912 in two runs, for all that it does not do: to give up on a late answer, to check sums, to decode, compare and
encode. With that ours is 25 to 40 µs behind it.""",
    ground="floor in a loop of trio",
    rounds=2,
)
