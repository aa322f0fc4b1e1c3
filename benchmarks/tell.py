"""How many messages a second go into one actor of the same process?"""

from __future__ import annotations

from benchmarks.house import Figures, Goal, Question, beside
from benchmarks.sides.erlang import erlang


def _side(name: str, short: bool) -> Figures:
    return beside("benchmarks.sides.tell", name, *(["short"] if short else []))


QUESTION = Question(
    name="tell",
    title="How many messages a second go into one actor of the same process?",
    sides={
        "ours": lambda short: _side("ours", short),
        "trio": lambda short: _side("trio", short),
        "asyncio": lambda short: _side("asyncio", short),
        "pykka": lambda short: _side("pykka", short),
        "erlang": lambda short: erlang("tell", short),
    },
    goals=(
        Goal("tell_per_s", "trio", at_least=13.0),
        Goal("tell_per_s", "pykka", at_least=15.0, gross=8.0),
        Goal("tell_per_s", "erlang", at_least=0.45),
        Goal("bounded_per_s", "trio", at_least=13.0),
    ),
    limit=(
        "A message costs 350 ns to tell and 370 ns to handle (an interleaved run of both halves alone, "
        "Python 3.11). Of these four nested calls are 150 ns, the pair of message and answer 40 ns each "
        "way, the reading of the clock that recordings need 45 ns; a pass of the scheduler each 64 messages "
        "is 62 ns. What no actor can do without, a deque in and out and the handler's own call, is 85 ns."
    ),
)
