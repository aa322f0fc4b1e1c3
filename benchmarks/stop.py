"""From a stop to the safe frame, whatever the policy does, and from an e-stop over the mesh."""

from __future__ import annotations

from benchmarks.house import Figures, Goal, Question, Side
from benchmarks.stage import at_twins

ROBOTS = {"so101": "feetech", "ur5e": "ur"}
CASES = ("idle", "blocked", "computing")


def side(who: str, peer: str = "") -> Side:
    stop = at_twins(ROBOTS, "stop", who, peer=peer)
    estop = at_twins({"ur5e": "ur"}, "mesh_stop", who, peer=peer)

    def ask(short: bool) -> Figures:
        return stop(short) | estop(short)

    return ask


FIGURES = (
    *(f"{wire}_stop_{case}_ms" for wire in ROBOTS.values() for case in CASES),
    *(f"ur_task_{case}_ms" for case in CASES),
    *(f"ur_estop_{case}_ms" for case in ("idle", "blocked")),
)

QUESTION = Question(
    name="stop",
    title="From a stop to the safe frame",
    sides={"ours": side("ours"), "strands-robots": side("strands", "strands")},
    goals=tuple(Goal(figure, "", at_most=2.0, gross=25.0) for figure in FIGURES),
    limit="""The call crosses from the caller's thread to its loop, over zenoh to the wire process, and the frame to
the twin: four wake-ups. A policy that computes in the caller's own process holds the interpreter's lock 5 ms at a
time, and each of the caller's two threads waits for it. On a UR the frame is ur-rtde's, sent from a worker thread
behind the setpoint that is on its way.""",
)
