"""The same as ``steady`` where the system grants SCHED_FIFO to every side."""

from __future__ import annotations

from benchmarks.steady import question

QUESTION = question(
    "steady_fifo",
    "How evenly a rollout's setpoints come, with SCHED_FIFO",
    "yes",
    """As above. Caller, root and wire run before everything else; what is left is the wake-up of a second core,
once for each process boundary (the last column, which misses every goal, too), and Python's work in between: 0.3 to
0.8 ms at p99, whatever else the machine does, where `trio.sleep_until` by itself has 0.7 to 6, the reference 0.3 to
30.""",
)
