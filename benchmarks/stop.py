"""How long does it take from a stop to the safe frame, under several policies, and from an e-stop over the
mesh?"""

from __future__ import annotations

from . import peers
from .house import Figures, Goal, Question, Side, beside
from .stage import at_twins

ROBOTS = {"so101": "feetech", "ur5e": "ur"}
LEGS = "unitree_g1"
CASES = ("idle", "blocked", "computing")


def side(who: str, peer: str = "") -> Side:
    stop = at_twins(ROBOTS, "stop", who, peer=peer)
    estop = at_twins({"ur5e": "ur"}, "mesh_stop", who, peer=peer, timeout_s=300)

    def ask(short: bool) -> Figures:
        return stop(short) | legs(who)(short) | estop(short)

    return ask


def legs(who: str) -> Side:
    """Return the side with a G1. The reference's one needs no twin, since a stand-in replaces the SDK."""
    if who == "ours":
        return at_twins({LEGS: "g1"}, "stop", who)

    def ask(short: bool) -> Figures:
        length, python = "short" if short else "long", peers.python(who)
        found = beside("benchmarks.sides.stop", who, length, LEGS, "", "", python=python, timeout_s=240)
        return {f"g1_{figure}": value for figure, value in found.items()}

    return ask


FIGURES = (
    *(f"{wire}_stop_{case}_ms" for wire in ROBOTS.values() for case in CASES),
    *(f"{wire}_task_{case}_ms" for wire in ("ur", "g1") for case in CASES),
    *(f"ur_estop_{case}_ms" for case in ("idle", "blocked")),
)

QUESTION = Question(
    name="stop",
    title="From a stop to the safe frame",
    sides={
        "ours": side("ours"),
        "strands-robots": side("strands", "strands"),
        "plain zenoh and the SDK": at_twins({"ur5e": "ur"}, "mesh_stop", "bare", timeout_s=300),
    },
    goals=tuple(Goal(figure, "", at_most=2.0) for figure in FIGURES),
    limit="""All goals are met on a machine in a good hour: 0.7 to 1.7 ms (27 November). In a bad hour, in which
a wake-up takes two to three times as long, three of the 14 were met: 1.0 to 3.0 ms on a UR (once 5.1), 3 to 6 on
the third row of a G1 (26 November, in turns with the code of the 22nd, which took 1.2 to 2.3 and 6 to 9). The
call crosses from the caller's thread to its loop and from there to the wire process: 0.6 to 1.8 ms, independent
of the policy. Half of that is waking up (two fifths of all samples are in epoll; see `setpoint`).

On a UR ur-rtde sends the frame, and waits until the script has taken the setpoint before. The G1's policy of the
third row computes in the caller for 30 of its 32 ms, and keeps the interpreter's lock. The path needs that lock
four times, and requests it every 0.1 ms (Python's own interval is 5 ms: 12 ms then).

An e-stop over the mesh (`estop_button`) is mostly zenoh and ur-rtde. `plain zenoh and the SDK`, a `put` and a
process that only moves one arm, took 0.8 to 1 ms in six runs and 2 in one. Ours, medians of 16 with time stamps
at each hop: 0.26 for the `put`, for which zenoh has to wake up; 0.3 in zenoh's threads; 0.1 in the root's, which
forwards the stop; 0.16 until the gate has it; 0.3 to the transport and into the thread that may wait for ur-rtde;
0.3 there. The order reaches two robots at once, whose processes share two cores with two twins and two callers.
When callers and roots were notified at once, too, that took another 0.5 to 1 ms, so they are notified 3 and 4 ms
later. The reference's e-stop of a blocked issuer takes 2 s.""",
    ground="plain zenoh and the SDK",
    rounds=1,
)
