"""How long does it take from a stop until the robot receives a stop command, under several policies? How long if
the stop is an e-stop over the network?
"""

from __future__ import annotations

from . import peers
from .house import Figures, Goal, Question, Side, beside
from .stage import side_with_twins

ROBOTS = {"so101": "feetech", "ur5e": "ur"}
LEGS = "unitree_g1"
CASES = ("idle", "blocked", "computing")


def side(program: str, peer: str = "") -> Side:
    stop = side_with_twins(ROBOTS, "stop", program, peer=peer)
    estop = side_with_twins({"ur5e": "ur"}, "mesh_stop", program, peer=peer, timeout_s=300)

    def ask(short: bool) -> Figures:
        return stop(short) | legs(program)(short) | estop(short)

    return ask


def legs(program: str) -> Side:
    """Return the side with a Unitree G1. strands-robots needs no simulated robot there, since a fake replaces its
    SDK.
    """
    if program == "ours":
        return side_with_twins({LEGS: "g1"}, "stop", program)

    def ask(short: bool) -> Figures:
        length, python = "short" if short else "long", peers.python(program)
        result = beside("benchmarks.sides.stop", program, length, LEGS, "", "", python=python, timeout_s=240)
        return {f"g1_{figure}": value for figure, value in result.items()}

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
        "plain zenoh and the SDK": side_with_twins({"ur5e": "ur"}, "mesh_stop", "bare", timeout_s=300),
    },
    goals=tuple(Goal(figure, "", at_most=2.0) for figure in FIGURES),
    limit="""All goals are met in a good hour of the computer: 0.7 to 1.7 ms (27 November). In a bad hour a wake-up
takes two to three times as long. Three of the 14 goals were met then. A UR took 1.0 to 3.0 ms (once 5.1), and the
third row of a G1 3 to 6 (26 November; code of the 22nd, run in turns with it, took 1.2 to 2.3 and 6 to 9). The
call passes from the caller's thread to its loop and from there to the wire process: 0.6 to 1.8 ms, independent of
the policy. Half of that is waking up (two fifths of all samples are in epoll; see `setpoint`).

On a UR ur-rtde sends the frame, after it has waited until the robot's script has accepted the previous setpoint.
In the third row of the G1, the policy computes in the caller's process for 30 of every 32 ms, and keeps the
interpreter's lock. The stop needs that lock four times, and the package requests it every 0.1 ms (with Python's
own interval of 5 ms, a stop took 12 ms).

An e-stop over the network between robots (`estop_button`) is mostly zenoh and ur-rtde. `plain zenoh and the SDK`
is one zenoh message to a process that only moves one arm. It took 0.8 to 1 ms in six runs and 2 in one. In this
package, the parts are these (medians of 16, in ms, with a time stamp after each step): 0.26 for the zenoh message,
since zenoh has to wake up; 0.3 in zenoh's threads; 0.1 in the root process, which forwards the stop; 0.16 until
the wire process handles it; 0.3 until the thread that waits for ur-rtde; 0.3 in that thread. The e-stop reaches
two robots at once. Their processes share two cores with two simulated robots and two callers. When callers and
roots were notified at the same time, the stop took another 0.5 to 1 ms. So they are notified 3 and 4 ms later. In
strands-robots, the e-stop takes 2 s if the policy of the sender's own robot blocks.""",
    ground="plain zenoh and the SDK",
    rounds=1,
)
