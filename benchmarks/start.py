"""How long does it take from ``import strands_actors`` to an armed robot?"""

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
    limit="""trio and msgspec are 93 to 95 ms of the import's 113 to 119 ms of processor time. Of the rest zenoh
is 2.4 ms, json 1.2 ms, and nearly all else our own modules (`-X importtime`). asyncio, entry points and the code
of the root are imported when they are needed. Before the robot is armed, first the twin and then the root are
executed, each importing trio, and the root forks the wire.""",
    short=False,
    rounds=3,
)
