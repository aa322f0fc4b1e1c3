"""How evenly the setpoints of a rollout come, at 30 to 1000 Hz, and what disturbs them."""

from __future__ import annotations

from benchmarks import peers
from benchmarks.house import Figures, Goal, Question, Side, beside

CELLS = [f"{hz}hz_{load}" for hz in (30, 125, 500, 1000) for load in ("idle", "computing", "busy")]


def side(who: str, fifo: str, peer: str = "") -> Side:
    def ask(short: bool) -> Figures:
        python = {"python": peers.python(peer)} if peer else {}
        return beside("benchmarks.sides.steady", who, "short" if short else "long", fifo, timeout_s=200, **python)

    return ask


def question(name: str, title: str, fifo: str, limit: str) -> Question:
    return Question(
        name=name,
        title=title,
        sides={
            "ours": side("ours", fifo),
            "strands-robots": side("strands", fifo, "strands"),
            "trio.sleep_until": side("trio", fifo),
            "Python time.sleep": side("python", fifo),
            "Python and a second process": side("relayed", fifo),
            "C clock_nanosleep": side("c", fifo),
        },
        goals=tuple(Goal(f"{cell}_p99_us", "C clock_nanosleep", at_most=1.2, gross=30.0) for cell in CELLS),
        limit=limit,
        ground="Python and a second process",
        rounds=3,
        short=False,
    )


QUESTION = question(
    "steady",
    "How evenly a rollout's setpoints come",
    "no",
    """A setpoint is made by the policy's actor in the caller, on a timerfd tick, and crosses a process boundary to
the wire: the C loop does neither. `p99` is how far the time between two new setpoints is from the period, `wire`
that between any two frames (the tree sends the last again when a new one is late), `late` the share that is
missing or off by more than a quarter period. `computing` works 30 of 50 ms in the process of the policy.

At 30 Hz the p99 is the worst of 80, and the C loop's own varies from 14 to 3000 µs from run to run: the ratio
is the machine's mood as much as ours. The last column is the least that Python can whose wire is another
process, which is what outlives a script that is killed: one thread, `time.sleep`, a byte to a second process,
a stamp there. It is 1.4 to 340 times as far off as the C loop (1.14 in one cell, where its three rounds were
1.12 to 13): 1.2 is out of reach of a wall between the two. `trio.sleep_until`, which has no such wall and
rounds to milliseconds, is off by more than that and, idle, by more than ours. With a policy that computes,
Python passes the interpreter's lock on every 5 ms only; ours is better by asking for it every 0.1 ms, and
cannot be as good as C beside a lock. Idle, ours is two to four times as far off as the last column: a
setpoint is some 300 µs of Python in two processes with caches that have slept, and how long that takes
varies. With both cores busy each of three processes stands in line for a core, by the scheduler's slices of 3
to 4 ms; that is what SCHED_FIFO is for.""",
)
