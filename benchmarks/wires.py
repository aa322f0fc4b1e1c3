"""How fast are a command and a stop, and how much processor time do they take, on the wires after the first
five? The other side is the client that most users of the robot have."""

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


LIMIT = """Ours has one process more on the path than a client in the caller's own thread. The command crosses
from the caller to the wire process and through its gates (see `setpoint`), about 1 ms. The benefit: a client's
process that is killed or busy computing stops nothing.

The figures do not show that a client's call blocks its own thread, so a script of one thread stops only when its
last command has been answered. Here every command that is stopped has its own thread, and the stop comes 50 ms
after the command began, which favours the clients. Wire, root and twin run with a higher priority than ordinary
programs, as for users who grant it; the caller of either side does not. Goals are the bounds that the drivers
publish; for a twin that goes on after a freeze, the bound of a link that is back.

A Reachy's stop waits 30 ms for the answer to a command that is on its way, because it must not overtake it. Then
it opens a new WebSocket, whose handshake is answered 300 ms late, too. With a daemon as late as this it misses
the bound. So does REST, which has to ask for the running moves. `frozen stop` is measured from when the twin goes
on, `frozen call` from the call until it came back, with the twin frozen for 1 s. Ours reports which robots are
confirmed; roslibpy's only publishes.

Stops differ: ours of a Crazyflie is a landing and cflib's a hover; ours of a Stretch stops every board and its
client's the lift; panda's and fr3's clients ask for StopMove. Setpoints of panda and fr3 are measured from the
call to the request to move (panda-python clears errors before). Those of a Kinova are measured to the first
speeds that are new, those of an iiwa to the next answer that the controller asks for, every 10 ms. `wire` is the
process that has the wire, `all` that and root, standby and caller; for a client it is the script with the client
in it. Shares are of one core at the control rate, of panda and fr3 during a motion at 1 kHz, in steps of 0.3 %.
Ours reads and publishes the robot's state meanwhile; the clients read only what they read by themselves."""


@dataclass(frozen=True)
class Compared:
    """The client of a robot that ours is compared with.

    Attributes:
        client: A module of ``sides/wire_clients``; empty if no client is available.
        peer: The environment of the client; empty for ours.
        service: True if the robot is behind a server process.
        twin: Options of the twin that this client needs.
    """

    client: str = ""
    peer: str = ""
    service: bool = False
    twin: Mapping[str, object] = field(default_factory=dict)


WIRES: dict[str, Compared] = {
    "xarm7": Compared("xarm"),
    "kinova_gen3": Compared(),  # the vendor's client is not on a package index
    "kuka_iiwa": Compared(),  # the vendor's licence ties its client to its robots
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


def at_twin(robot: str, who: str, length: str) -> Figures:
    """Run one side at one robot's twin."""
    compared = WIRES[robot]
    ours = who == OURS
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
            *(who if ours else compared.client, length, robot, str(hz), twin.port, str(twin.log.path), *service),
            timeout_s=TIMEOUT_S,
            **python,
        )


def at_quicker_twin(robot: str, who: str, length: str) -> Figures:
    """Run our side at the highest control rate."""
    hz, options = QUICKER[robot]
    usual_hz = driver_of(robot).timing.control_hz
    with (
        tempfile.TemporaryDirectory(prefix="sa-") as directory,
        Twin(robot, Path(directory), options=options) as twin,
    ):
        return beside("benchmarks.sides.wires", "quicker", length, robot, str(usual_hz), str(hz), twin.port)


def patiently(ask: Callable[[str, str, str], Figures], robot: str, who: str, length: str) -> Figures:
    """Run a side. If it fails because the computer is busy, print this and run it again, ``TRIES`` times in
    all."""
    for left in reversed(range(TRIES)):
        try:
            return ask(robot, who, length)
        except (RuntimeError, TimeoutError) as late:
            if not left:
                raise
            print(f"{robot}, {who}, is tried again: {late}", file=sys.stderr, flush=True)
    raise AssertionError


class LateLine:
    """Runs ``sides.late_answers`` between a client and a twin, during a ``with`` block.

    ``port`` is the address for the client. A query after a ``?`` is the twin's.
    """

    def __init__(self, port: str, directory: Path, flag: Path) -> None:
        self._there, query, self._more = port.partition("?")
        self._more = query + self._more
        host = self._there.rpartition(":")[0]
        here = f"{host}:0" if host else str(directory / "late.sock")
        self._command = [sys.executable, "-m", "benchmarks.sides.late_answers", here, self._there, str(flag)]

    def __enter__(self) -> LateLine:
        self._line = subprocess.Popen(self._command, cwd=HOUSE.parent, stdout=subprocess.PIPE, text=True)
        assert self._line.stdout is not None
        self.port = self._line.stdout.readline().strip() + self._more
        return self

    def __exit__(self, *_: object) -> None:
        self._line.kill()
        self._line.communicate()


def side(who: str) -> Side:
    def ask(short: bool) -> Figures:
        figures: Figures = {}
        length = "short" if short else "long"
        for robot, compared in WIRES.items():
            asked = [at_twin] if who == OURS or compared.client else []
            asked += [at_quicker_twin] if who == OURS and robot in QUICKER else []
            for ask_one in asked:
                found = patiently(ask_one, robot, who, length)
                figures |= {f"{robot}_{figure}": value for figure, value in found.items()}
        return figures

    return ask


def goals_of(robot: str) -> tuple[Goal, ...]:
    """Return the goals of a robot. The bound of each stop is the one that its driver publishes. After a
    twin was frozen, it is the bound of a returned link."""
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
    limit=LIMIT,
    rounds=1,
)
