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
    """Return the side (program) with a Unitree G1. For strands-robots no G1 is simulated, since a fake replaces
    its SDK.
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
    notice="""On `stop()` the robot stands within 2 ms, even if the script is blocked. With strands-robots, a script
that is blocked keeps an arm moving for 2 s, and legs for 6 s.""",
    limit="""In a good hour of the computer all goals are met, and a stop takes 0.7 to 1.7 ms (27 November). In a
bad hour (26 November) a wake-up took two to three times as long, and only three of the 14 goals were met. In the
bad hour a stop of a UR took 1.0 to 3.0 ms (once 5.1 ms), and `g1 task computing` 3 to 6 ms. (The code of 22
November, run in turns with that of 26 November, took 1.2 to 2.3 ms for the UR and 6 to 9 ms for the G1.) The call
of a stop passes from the caller's thread to the caller's loop and from there to the wire process, in 0.6 to 1.8
ms, independent of the policy. Half of the time of this call is spent on wake-ups (two fifths of all samples of the
profile are in epoll).

On a UR ur-rtde sends the frame, after it has waited until the robot's script has accepted the previous setpoint.
In `g1 task computing`, the policy computes in the caller's process for 30 of every 32 ms, and keeps the
interpreter's lock. A stop needs the interpreter's lock four times, and the package makes Python pass the lock on
every 0.1 ms (with Python's own interval of 5 ms, a stop took 12 ms).

An e-stop over the network between robots (`estop_button`) spends most of its time in zenoh and ur-rtde. `plain
zenoh and the SDK` is one zenoh message to a process that only moves one arm. `plain zenoh and the SDK` took 0.8 to
1 ms in six runs and 2 ms in one run. In this package, an e-stop over the network has these parts (medians of 16,
in ms, with a time stamp after each step): 0.26 for the zenoh message, since zenoh has to wake up; 0.3 in zenoh's
threads; 0.1 in the root process, which forwards the stop; 0.16 until the wire process handles it; 0.3 until the
thread that waits for ur-rtde; 0.3 in that thread. The e-stop reaches two robots at once, and the processes of
these robots share two cores with two simulated robots and two callers. When callers and root processes were
notified of the e-stop at the same time as the wire processes, the e-stop took another 0.5 to 1 ms. So callers and
root processes are now notified of an e-stop 3 and 4 ms later than wire processes. In strands-robots, the e-stop
takes 2 s if the policy of the sender's own robot blocks.""",
    ground="plain zenoh and the SDK",
    rounds=1,
)
