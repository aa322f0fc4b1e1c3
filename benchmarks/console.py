"""How much does the console cost with a hundred robots, and do its viewers delay a stop?"""

from __future__ import annotations

from .house import Figures, Goal, Question, Side, beside


def with_viewers(viewers: int) -> Side:
    def run(short: bool) -> Figures:
        words = ("short" if short else "long", str(viewers))
        return beside("benchmarks.sides.console", *words, timeout_s=600)

    return run


QUESTION = Question(
    name="console",
    title="The console with 100 robots and 100 slow viewers",
    sides={"ours": with_viewers(100), "without_viewers": with_viewers(0)},
    goals=(
        Goal("page_hz", "", at_least=30.0),
        Goal("server_pct", "", at_most=33.3),
        Goal("estop_p99_ms", "without_viewers", at_most=1.1),
        Goal("stop_p99_ms", "without_viewers", at_most=1.1),
    ),
    notice="""A page that lists 100 robots stays smooth. `page_hz` and `server_pct` are of this page. `estop`
and `stop` are the page of the e-stop and the button of a robot: the time from the request until the safe frame
is on the wire of an arm on its twin, which 100 viewers watch.""",
    limit="""The 100 robots are stand-ins that only publish, behind one router. The browser draws without a
graphics card, and the viewers are programs that read one message a second. All of them share two cores with the
console. One thread serves all pages, and another one the page of the e-stop, so a stop waits for the
interpreter's lock and for a processor. To serve the pages at different moments did not shorten the longest
waits, so that was not kept. A process for stops alone would help.""",
    rounds=2,
)
