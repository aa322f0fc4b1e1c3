"""How long does a stop message wait if 10 000 messages of 20 us each are queued before it?"""

from __future__ import annotations

from .house import Goal, Question, side_of

QUESTION = Question(
    name="urgent",
    title="How long does a stop wait behind 10 000 queued messages of 20 µs each?",
    sides={
        "ours": side_of("urgent", "ours"),
        "trio": side_of("urgent", "trio"),
        "pykka": side_of("urgent", "pykka"),
    },
    goals=(Goal("urgent_p50_us", "", at_most=70.0),),
    notice="""A stop overtakes all waiting messages, in 0.04 ms. With the other sides it takes 0.2 s, in
which a fast joint turns by 40 degrees.""",
    limit=(
        """A stop waits until the running handler has ended (20 µs). If the sender is a task of the same loop, the
stop also waits for at most one turn of the actor, 200 µs."""
    ),
)
