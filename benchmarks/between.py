"""How long does a request to an actor in another process take, and how many messages per second arrive there?"""

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
    limit="""An ask is a request with an answer, a tell a message without an answer. Plain zenoh answers inside the
callback, on a thread of zenoh. A process that keeps its state in one loop has to pass each message to that loop
and the answer back. `zenoh into trio` is the smallest program that does this: a callback, trio's own way to wake
its loop, and a deadline. It takes a quarter longer than this package, which also has actors, types and priorities.
So the limit of the library is 1.7 to 2.6 times a zenoh message and its answer, and 0.45 to 0.6 of Ray.

A tell is a separate zenoh message. zenoh sends messages in batches when many wait: 17 µs each. Nearly all of that
is zenoh's call of our callback, which takes the interpreter's lock for each message. (Many tells in one frame took
2 µs each, but needed a second format of messages. No robot needs that: a robot with legs gets 500 per second.)""",
    short=False,
    ground="zenoh into trio",
    rounds=3,
)
