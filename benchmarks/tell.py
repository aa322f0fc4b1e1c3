"""How many messages a second go into one actor of the same process?"""

from __future__ import annotations

from .house import Goal, Question, side_of
from .sides.erlang import erlang

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
        Goal("tell_per_s", "pykka", at_least=15.0),
        Goal("tell_per_s", "erlang", at_least=0.45),
        Goal("bounded_per_s", "trio", at_least=13.0),
    ),
    ground="a deque and a call",
    limit="""A message costs 125 ns to tell and 195 ns to handle (the halves timed alone in bursts of 1000,
Python 3.11, on the machine of the table), of which reading the clock, which recordings need, is 45 ns, and the
handler's own call as much. The rest is what makes it a message: its type looked up, its lane, the bound, the time
it was taken up, the turn, each some 20 bytecodes of this interpreter. It was 40 % more until `isinstance` of a
message, which asks msgspec's metaclass for 50 ns, and a call for the command lane were gone, and a turn had room
for 1024 messages instead of 128, between which trio's loop passes once.""",
)
