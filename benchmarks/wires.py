"""How fast are a command and a stop, and how much processor time do they take? The robots are those of ``WIRES``,
which came after the first five. At each robot, this package is compared with the client that most users of the
robot have.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path

from strands_actors.testing import Twin
from strands_actors.testing.bench import driver_of
from strands_actors.testing.faults import RETURN_S

from . import peers
from .house import HOUSE, OURS, Figures, Goal, Question, Side, beside

OTHERS = "the usual client"
TIMEOUT_S = 240.0
TRIES = 3


LIMIT = """This package has one process more than a client in the script's own process. A command passes from the
caller to the wire process, which checks it and writes it to the robot. The way of a command through the wire
process takes about 1 ms (see the section on `send_action`). The benefit of the wire process is that the robot is
still stopped when the caller is killed or busy.

The figures do not show one property of the clients. A client's call blocks its thread, so a script with one thread
can stop only when its last command has been answered. In this benchmark every command that is stopped has its own
thread, and the stop comes 50 ms after the command has begun, which favours the clients. Our wire process, our root
process and the simulated robot have a higher priority than ordinary programs, as for users who grant it. The
callers of both sides have the priority of ordinary programs. The goals for stops are the bounds that the drivers
publish. For a simulated robot that continues after a freeze, the goal is the bound of a restored connection.

A Reachy's stop waits 30 ms for the answer to the previous command, because it must not overtake that command.
After these 30 ms the stop of a Reachy opens a new WebSocket. If the Reachy's daemon answers 300 ms late, the
handshake of the WebSocket is late, too, and the stop misses the bound. A stop over REST also misses the bound if
the daemon answers late, because it first has to request the list of running moves. `frozen stop` is the time from
the moment at which the simulated robot continues. `frozen call` is the duration of the call, with a robot that is
frozen for 1 s. Our stop reports the robots that have confirmed it. A stop with roslibpy only publishes a message.

The sides stop in different ways. A Crazyflie lands with this package and hovers with cflib. A Stretch stops all
its boards with this package and only the lift with the vendor's client. The clients of panda and fr3 request
StopMove. Setpoints of panda and fr3 are measured from the call to the request to move (panda-python clears errors
before). Setpoints of a Kinova are measured until the first changed speeds, and setpoints of an iiwa until the next
answer that the controller requests, every 10 ms. `wire` is the process that writes to the robot. `all` includes
the root, standby and caller processes. For a client, `all` is the script that runs the client. Figures in percent
are shares of one core at the control rate (for panda and fr3 during a motion at 1 kHz), in steps of 0.3 %. While
these shares are measured, this package reads and publishes the robot's state, and the clients read only the data
that they read by themselves."""


@dataclass(frozen=True)
class Compared:
    """The client with which this package is compared at one robot.

    Attributes:
        client: A module of ``sides/wire_clients``; empty if no client is available.
        peer: The Python environment of the client; empty for the environment of this package.
        service: True if clients reach the robot through a server process.
        twin: Options of the simulated robot that this client needs.
    """

    client: str = ""
    peer: str = ""
    service: bool = False
    twin: Mapping[str, object] = field(default_factory=dict)


WIRES: dict[str, Compared] = {
    "xarm7": Compared("xarm"),
    "kinova_gen3": Compared(),  # no comparison, since the vendor's client is not on a package index
    "kuka_iiwa": Compared(),  # no comparison, since the client's licence allows it only with the vendor's robots
    "panda": Compared("panda"),
    "fr3": Compared("fr3"),
    "spot": Compared("spot", service=True),
    "rby1": Compared("rby1", service=True),
    "reachy_mini": Compared("reachy", service=True),
    "microduck": Compared("microduck", "microduck", service=True),
    "earthrover": Compared("earthrover", service=True),
    "yahboom_m3pro": Compared("yahboom", service=True),
    "booster_t1": Compared("booster", twin={"domain": 91, "multicast": True, "host": "127.0.0.1"}),
    "crazyflie": Compared("crazyflie", "cflib"),
    "stretch3": Compared("stretch", "stretch_body"),
}


QUICKER: dict[str, tuple[float, Mapping[str, object]]] = {
    "xarm7": (250.0, {}),
    "kinova_gen3": (100.0, {}),
    "kuka_iiwa": (100.0, {"sample_ms": 2}),
}
"""The highest control rate that an arm's driver accepts, in Hz, and the options of its twin for this."""


def run_with_twin(robot: str, program: str, length: str) -> Figures:
    """Start one simulated robot, and run one side (program) that commands it."""
    compared = WIRES[robot]
    ours = program == OURS
    python = {} if ours or not compared.peer else {"python": peers.python(compared.peer)}
    hz = driver_of(robot).timing.control_hz
    with ExitStack() as stack:
        directory = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="sa-")))
        twin = stack.enter_context(Twin(robot, directory, options={} if ours else compared.twin))
        service: list[str] = []
        if compared.service:
            flag = directory / "late"
            line = stack.enter_context(LateLine(twin.port, directory, flag))
            service = [str(twin.process.pid), line.port, str(flag)]
        return beside(
            "benchmarks.sides.wires",
            *(
                program if ours else compared.client,
                length,
                robot,
                str(hz),
                twin.port,
                str(twin.log.path),
                *service,
            ),
            timeout_s=TIMEOUT_S,
            **python,
        )


def run_with_quicker_twin(robot: str, program: str, length: str) -> Figures:
    """Run this package at the highest control rate that the driver of the robot accepts."""
    hz, options = QUICKER[robot]
    usual_hz = driver_of(robot).timing.control_hz
    with (
        tempfile.TemporaryDirectory(prefix="sa-") as directory,
        Twin(robot, Path(directory), options=options) as twin,
    ):
        return beside("benchmarks.sides.wires", "quicker", length, robot, str(usual_hz), str(hz), twin.port)


def patiently(ask: Callable[[str, str, str], Figures], robot: str, program: str, length: str) -> Figures:
    """Run a side (program). If it fails, print the error and run it again, ``TRIES`` times in all, because a busy
    computer may be the cause.
    """
    for tries_left in reversed(range(TRIES)):
        try:
            return ask(robot, program, length)
        except (RuntimeError, TimeoutError) as late:
            if not tries_left:
                raise
            print(f"{robot}, {program}, is tried again: {late}", file=sys.stderr, flush=True)
    raise AssertionError


class LateLine:
    """A proxy between a client and a simulated robot that delays answers (``sides.late_answers``), for a ``with``
    block.

    ``port`` is the address for the client. It ends with the query (``?...``) of the robot's address, if there is
    one.
    """

    def __init__(self, port: str, directory: Path, flag: Path) -> None:
        self._service_address, query, self._more = port.partition("?")
        self._more = query + self._more
        host = self._service_address.rpartition(":")[0]
        address = f"{host}:0" if host else str(directory / "late.sock")
        self._command = [
            sys.executable,
            "-m",
            "benchmarks.sides.late_answers",
            address,
            self._service_address,
            str(flag),
        ]

    def __enter__(self) -> LateLine:
        self._line = subprocess.Popen(self._command, cwd=HOUSE.parent, stdout=subprocess.PIPE, text=True)
        assert self._line.stdout is not None
        self.port = self._line.stdout.readline().strip() + self._more
        return self

    def __exit__(self, *_: object) -> None:
        self._line.kill()
        self._line.communicate()


def side(program: str) -> Side:
    def ask(short: bool) -> Figures:
        figures: Figures = {}
        length = "short" if short else "long"
        for robot, compared in WIRES.items():
            runs = [run_with_twin] if program == OURS or compared.client else []
            runs += [run_with_quicker_twin] if program == OURS and robot in QUICKER else []
            for run in runs:
                result = patiently(run, robot, program, length)
                figures |= {f"{robot}_{figure}": value for figure, value in result.items()}
        return figures

    return ask


def goals_of(robot: str) -> tuple[Goal, ...]:
    """Return the goals of a robot: the longest times from a stop to the first stop command that the robot receives.

    The limit is the bound that the robot's driver publishes. For a stop after a freeze of the robot, it is the
    bound for a restored connection (``RETURN_S``).
    """
    bound_ms = driver_of(robot).bound_s * 1e3
    goals = {"stop_worst_ms": bound_ms}
    if WIRES[robot].service:
        goals |= {"late_stop_worst_ms": bound_ms, "frozen_stop_worst_ms": RETURN_S * 1e3}
    return tuple(Goal(f"{robot}_{figure}", "", at_most=at_most) for figure, at_most in goals.items())


QUESTION = Question(
    name="wires",
    title="A command, a stop and the processor on the wires that came later",
    sides={OURS: side(OURS), OTHERS: side("other")},
    goals=tuple(goal for robot in WIRES for goal in goals_of(robot)),
    notice="""Nothing on most robots: a command leaves some 0.5 ms later than with the usual client, and the
processor does 5 to 20 % of a core more. A stop leaves within 4 ms. It takes up to 11 ms on a KUKA, which
listens once in 5 ms, and 340 ms on a Reachy that answers late.""",
    limit=LIMIT,
    rounds=1,
)
