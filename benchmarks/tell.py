"""How many messages per second can one actor receive from its own process?"""

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
    notice="""Nothing: a robot needs some thousand messages in a second, and this is a thousand times as many.""",
    limit="""A message costs 125 ns to send and 195 ns to handle (measured separately in groups of 1000, Python
3.11, on the computer of the table). 45 ns of that is a reading of the clock, which recordings need, and the call
of the handler takes another 45 ns. The rest is work for each message, in steps of some 20 bytecodes of this
interpreter: look up the type and the priority of the message, check the length of the queue, note the time at
which the message was taken from the queue, and limit the number of messages in one turn.

Before three changes a message cost 40 % more. First, the code no longer calls `isinstance`, which spends 50 ns in
msgspec's metaclass. Second, messages of the usual priority need no function call. Third, an actor handles up to
1024 messages instead of 128 in one turn, and trio's loop makes one pass between two turns.""",
)
