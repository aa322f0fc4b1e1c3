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
    notice="""Nothing at a control rate of 50 Hz. Each question to the robot's process delays a script by a
third of a millisecond, so a loop that asks a thousand times in a second leaves no time for anything else.""",
    limit="""An ask is a request with an answer, a tell a message without an answer. The side `zenoh` answers
inside zenoh's callback, on a thread of zenoh. A process that keeps its state in one event loop has to pass each
message from zenoh's thread to that loop, and the answer back. `zenoh into trio` is the smallest program that
passes zenoh's messages to a loop: a callback, trio's own way to wake its loop, and a deadline. `zenoh into trio`
takes a quarter longer than this package, which also has actors, types and priorities. So an ask over zenoh into a
loop takes at best 1.7 to 2.6 times as long as with `zenoh`, and 0.45 to 0.6 times as long as with Ray.

Each tell is a separate zenoh message. If many tells wait, zenoh sends them in batches, and each tell takes 17 µs.
Nearly all of these 17 µs are zenoh's call of our callback, which takes the interpreter's lock for each message.
(Many tells in one zenoh message took 2 µs each, but needed a second format of messages. No robot needs such a
rate, because even a robot with legs gets only 500 tells per second.)""",
    short=False,
    ground="zenoh into trio",
    rounds=3,
)
