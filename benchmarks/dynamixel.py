"""How fast can six Dynamixel servos be read (fast sync read) and written, compared with the vendor's SDK?"""

from __future__ import annotations

from .feetech import LIMIT, side
from .house import Goal, Question

QUESTION = Question(
    name="dynamixel",
    title="Dynamixel: read six servos and write six, at 1 Mbaud",
    sides={
        "ours": side("koch", "ours"),
        "our wire": side("koch", "wire"),
        "dynamixel-sdk": side("koch", "sdk"),
        "floor": side("koch", "floor"),
        "floor in a loop of trio": side("koch", "loop"),
    },
    goals=(
        Goal("of_limit_x", "", at_least=0.90),
        Goal("cpu_us", "dynamixel-sdk", at_most=0.3),
    ),
    notice="""The arm is read and commanded as often as with the vendor's SDK, but the processor stays free: 7 %
of a core are in use, not 98 %. These figures are of one loop. A robot gets
the side `our wire`, with its checks.""",
    limit=LIMIT.format(
        bytes=1200,
        whole="21 bytes per servo, in a frame per servo (in a fast sync read, a missing servo spoils the "
        "answers of all servos)",
        own=388,
    ),
    ground="floor in a loop of trio",
    rounds=2,
)
