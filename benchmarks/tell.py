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
    limit="""A message costs 125 ns to tell and 195 ns to handle (measured separately in bursts of 1000, Python
3.11, on the machine of the table). 45 ns of that reads the clock, which recordings need, and the handler's own
call takes as much. The rest is the work per message: the lookup of its type, its lane, the bound, the time at
which it was taken, the turn, each some 20 bytecodes of this interpreter.

It was 40 % more before three changes: no `isinstance` of a message, which asks msgspec's metaclass for 50 ns; no
call for the command lane; and room in a turn for 1024 messages instead of 128, between which trio's loop passes
once.""",
)
