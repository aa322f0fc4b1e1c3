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
    limit="""Plain zenoh answers from the callback, on zenoh's own thread. Who keeps the state of a process in
one loop hands each message over, there and back: `zenoh into trio` is the least of that, a callback, trio's own
way to wake its loop, a deadline, and it takes a quarter longer than ours, which has actors, types and lanes
besides. So the library's limit is 1.7 to 2.6 times a put and its answer, and 0.45 to 0.6 of Ray. A tell is a put of
its own, which zenoh batches when many are under way: 17 µs, nearly all of it zenoh's call of our callback, which
takes the interpreter's lock for each. (Many in one frame took 2 µs, and a second form of a message that no robot
needs: legs tell 500 times a second.)""",
    short=False,
    ground="zenoh into trio",
    rounds=3,
)
