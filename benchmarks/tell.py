"""How many messages a second go into one actor of the same process?"""

from __future__ import annotations

from benchmarks.house import Goal, Question, side_of
from benchmarks.sides.erlang import erlang

QUESTION = Question(
    name="tell",
    title="How many messages a second go into one actor of the same process?",
    sides={
        "ours": side_of("tell", "ours"),
        "trio": side_of("tell", "trio"),
        "asyncio": side_of("tell", "asyncio"),
        "pykka": side_of("tell", "pykka"),
        "a deque and a call": side_of("tell", "bare"),
        "erlang": lambda short: erlang("tell", short),
    },
    goals=(
        Goal("tell_per_s", "trio", at_least=13.0),
        Goal("tell_per_s", "pykka", at_least=15.0, gross=8.0),
        Goal("tell_per_s", "erlang", at_least=0.45),
        Goal("bounded_per_s", "trio", at_least=13.0),
    ),
    ground="a deque and a call",
    limit="""A message costs 210 ns to tell and 300 ns to handle (the halves timed alone in bursts of 2000,
Python 3.11), of which reading the clock, which recordings need, is 45 ns. Counted by callgrind (see
`instructions`) it is 8900 instructions, a deque in and out and the handler's call 1400 of them; the rest is what
makes it a message: its type looked up, its lane, the bound, the time it was taken up, the turn, each some 20
bytecodes of this interpreter. So nothing physical stands in the way, Python does: 13 times trio's unbounded
channel would be 320 ns for both halves. With the bound, which is how actors are used, the goal is met, since trio
then passes its scheduler for each message.""",
)
