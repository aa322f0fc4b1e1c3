"""How long does an ask take between two processes, and how many typed tells a second go there?"""

from __future__ import annotations

from benchmarks.house import Figures, Goal, Question, Side, beside


def _side(name: str) -> Side:
    def side(short: bool) -> Figures:
        return beside("benchmarks.sides.between", name, *(["short"] if short else []))

    return side


QUESTION = Question(
    name="between",
    title="How long does an ask take between two processes, and how many typed tells a second go there?",
    sides={
        name: _side(name) for name in ("ours", "zenoh", "zenoh into trio", "socket", "ray", "thespian", "xoscar")
    },
    goals=(
        Goal("ask_p50_us", "zenoh", at_most=1.15),
        Goal("ask_p99_us", "zenoh", at_most=1.15),
        Goal("ask_p50_us", "ray", at_most=0.35),
        Goal("tell_per_s", "ray", at_least=100.0),
    ),
    limit=(
        "Callbacks on zenoh's own thread take the interpreter's lock once per message: 20 µs while the loop "
        "is busy, against 3 µs for the rest of the receiver's work. An ask wakes a loop on each side (32 to 39 µs "
        "from a thread to the task that waits, measured alone), where plain zenoh answers from the callback."
    ),
    short=False,
    ground="zenoh into trio",
    rounds=3,
)
