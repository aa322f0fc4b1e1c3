"""How long does an ask take between two processes, and how many typed messages per second arrive?"""

from __future__ import annotations

from .house import Goal, Question, side_of

QUESTION = Question(
    name="between",
    title="How long does an ask take between two processes, and how many typed tells a second go there?",
    sides={
        name: side_of("between", name)
        for name in ("ours", "zenoh", "zenoh into trio", "socket", "ray", "thespian", "xoscar")
    },
    goals=(
        Goal("ask_p50_us", "zenoh", at_most=1.15),
        Goal("ask_p99_us", "zenoh", at_most=1.15),
        Goal("ask_p50_us", "ray", at_most=0.35),
        Goal("tell_per_s", "ray", at_least=10.0),
    ),
    limit="""Plain zenoh answers from the callback, on zenoh's own thread. A process that keeps its state in one
loop has to hand each message to that loop and back. `zenoh into trio` is the minimum of that: a callback, trio's
own way to wake its loop, and a deadline. It takes a quarter longer than ours, which also has actors, types and
lanes. So the library's limit is 1.7 to 2.6 times a put and its answer, and 0.45 to 0.6 of Ray.

A tell is a separate put. zenoh batches puts when many are under way: 17 µs each, nearly all of it zenoh's call of
our callback, which takes the interpreter's lock for each. (Many tells in one frame took 2 µs, but needed a second
form of a message. No robot needs that: legs tell 500 times a second.)""",
    short=False,
    ground="zenoh into trio",
    rounds=3,
)
