"""How long does it take from the start of ``import strands_actors`` until a robot's motors are energised?"""

from __future__ import annotations

from .house import Figures, Goal, Question, beside, side_of


def _reference(short: bool) -> Figures:
    from .peers import python

    return beside("benchmarks.sides.start_strands", *(["short"] if short else []), python=python("strands"))


QUESTION = Question(
    name="start",
    imports=True,
    title="How long does it take from the import to an armed robot?",
    sides={
        **{name: side_of("start", name) for name in ("ours", "trio and msgspec")},
        "strands-robots 0.5.3": _reference,
    },
    goals=(
        Goal("import_ms", "trio and msgspec", at_most=1.3),
        Goal("armed_ms", "", at_most=800.0),
        Goal("armed_on_wire_ms", "", at_most=800.0),
    ),
    notice="""A script has an armed robot after half a second.""",
    limit="""trio and msgspec take 93 to 95 ms of the import's 113 to 119 ms of processor time. zenoh takes 2.4 ms,
json 1.2 ms, and nearly all of the rest are our own modules (`-X importtime`). asyncio, entry points and the code
of the root process are imported only when they are needed. Before the robot is armed, three processes start: first
the simulated robot and then the root process are executed, each importing trio, and then the root forks the wire
process.""",
    short=False,
    rounds=3,
)
