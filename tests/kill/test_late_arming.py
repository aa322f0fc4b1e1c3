"""SAF-021: processes are killed while a robot is being energised, at moments spread over the verb.

The processes are real, and the simulation of the twin shows its motors. A request that is on its way
must not energise the robot after the last process has ended, nor after a safe state was reported as
confirmed.

The rows are in ``arming_rows.py``. The ordinary suite runs ``QUICK`` moments of a row, and the long
suite runs all of its ``moments``.
"""

from __future__ import annotations

import contextlib
import json
import os
import select
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest
import trio

from strands_actors.drivers.common.physics.body import Commander
from strands_actors.drivers.common.simulation_control import protocol
from strands_actors.drivers.common.simulation_control.client import SimulationClient
from strands_actors.testing import Twin
from strands_actors.testing.bench import driver_of

from .arming_rows import QUICK, ROWS, Row

VICTIMS = ("caller", "wire", "root", "root and wire")
GONE_S = 30.0
"""Time for processes to end, in addition to the time that the driver declares."""
ANSWER_S = 5.0
READS_S = 0.1
"""Time for a twin to carry out a control line."""
QUEUED = 0.6
"""The first moment of a row with a queue, as a share of the queue's time. By then the request was sent."""

CASES = [
    pytest.param(row, victim, moments, id=f"{row}-{victim}-{moments}", marks=marks)
    for row in ROWS
    for victim in VICTIMS
    for moments, marks in ((QUICK, ()), (row.moments, pytest.mark.long))
    if marks or victim in row.quick
]


class Trial:
    """One caller on one twin."""

    def __init__(self, row: Row, twin: Twin, directory: Path) -> None:
        self.row = row
        self.twin = twin
        self.log = twin.log
        self._control = str(directory / "control")
        self._run = directory / "run"
        self._errors = directory / "caller.err"
        self._twin_errors = directory / "twin.err"
        self._received = b""
        if row.queue_s:
            self._order("late 0 0")
        if row.fresh:
            twin.power_cycle()
        robot, _, level = row.robot.partition(":")
        keywords = {**row.keywords, "level": level} if level else row.keywords
        command = [sys.executable, "-m", "tests.kill.arming_caller", robot, twin.port]
        command += [json.dumps(keywords), json.dumps(row.arguments), row.verb, *row.before]
        with self._errors.open("w") as errors:
            self._caller = subprocess.Popen(
                command,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=errors,
                env={**os.environ, "STRANDS_ACTORS_RUN": str(self._run)},
            )
        try:
            assert self.line(90.0) == "ready"
            if row.queue_s:
                self._order(f"late {self.roles()['wire']} {row.queue_s}")
            # The log must contain the effects of the verb only.
            os.truncate(self.log.path, 0)
        except BaseException:
            self.end()
            raise

    def _order(self, line: str) -> None:
        """Send a control line to the twin. An unknown line is an error."""
        self.twin.order(line)
        time.sleep(READS_S)
        assert line not in self._twin_errors.read_text(), self._twin_errors.read_text()

    def line(self, within_s: float) -> Any:
        """Return the next line of the caller, decoded from JSON."""
        assert self._caller.stdout is not None
        deadline_s = time.monotonic() + within_s
        while b"\n" not in self._received:
            ready, _, _ = select.select([self._caller.stdout], [], [], max(0.0, deadline_s - time.monotonic()))
            assert ready, f"the caller printed nothing for {within_s:g} s"
            data = os.read(self._caller.stdout.fileno(), 65536)
            assert data, self._errors.read_text()
            self._received += data
        text, _, self._received = self._received.partition(b"\n")
        return json.loads(text) if text.startswith((b"{", b'"')) else self.line(within_s)

    def begin(self, line: str = "go") -> None:
        assert self._caller.stdin is not None
        self._caller.stdin.write(f"{line}\n".encode())
        self._caller.stdin.flush()

    def roles(self) -> dict[str, int]:
        """Return the living processes of this caller's tree, by role.

        A child that was just forked still has its parent's name, so it is left out.
        """
        mark, pids_by_role = f"STRANDS_ACTORS_RUN={self._run}".encode(), dict[str, int]()
        for entry in Path("/proc").iterdir():
            try:
                if not entry.name.isdigit() or mark not in (entry / "environ").read_bytes():
                    continue
                name = (entry / "comm").read_text().strip()
                state, parent = (entry / "stat").read_text().rpartition(")")[2].split()[:2]
            except OSError:
                continue
            if state not in "ZX":
                role = "caller" if int(entry.name) == self._caller.pid else name.removeprefix("strands-")
                role = role.partition("-")[0].partition("/")[0]
                if int(parent) != pids_by_role.get(role):
                    pids_by_role[role] = int(entry.name)
        return pids_by_role

    def kill(self, victim: str) -> list[str]:
        """Kill the victims, and return their roles.

        ``connect_eagerly`` starts the processes. Then the victims that already live are killed, or
        the caller if there is none.
        """
        roles = self.roles()
        victims = victim.split(" and ")
        if self.row.verb == "connect_eagerly":
            victims = [name for name in victims if name in roles] or ["caller"]
        for name in victims:
            os.kill(roles[name], signal.SIGKILL)
        if "caller" in victims:
            self._caller.wait()
        return victims

    @property
    def held_by_wire(self) -> bool:
        """Return whether the wire holds any motor in the twin's simulation."""
        return trio.run(self._hands)

    async def _hands(self) -> bool:
        client = SimulationClient(self._control)
        try:
            await client.call(protocol.Handshake(0), protocol.Axes, ANSWER_S)
            sample = await client.call(protocol.Read(0), protocol.Sample, ANSWER_S)
            return Commander.WIRE in sample.commanders
        finally:
            client.close()

    def kinds(self, *kinds: str) -> list[str]:
        """Return the kinds of the host's frames that are among these, in the order of the wire."""
        return [entry.kind for entry in self.log.entries() if entry.sender == "host" and entry.kind in kinds]

    def late_enables(self) -> int:
        """Return the number of enabling frames behind the last safe frame."""
        kinds = self.kinds("enable", "safe")
        last = max((index for index, kind in enumerate(kinds) if kind == "safe"), default=-1)
        return kinds[last:].count("enable") if last >= 0 else 0

    def end(self) -> None:
        for pid in self.roles().values():
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        self._caller.communicate()


class Bench:
    """Hold the twin in use. There is one at a time, because the ports of a wire may be fixed."""

    def __init__(self, directories: pytest.TempPathFactory) -> None:
        self._directories = directories
        self._key: tuple[str, Mapping[str, object]] = "", {}
        self._twin = contextlib.ExitStack()
        self._took_s: dict[str, float] = {}

    def trial(self, row: Row) -> Trial:
        """Start a caller on a twin with an empty log, and wait until it is ready."""
        robot = row.robot.partition(":")[0]
        if self._key != (robot, row.options):
            self.close()
            self._key, self._directory = (robot, row.options), self._directories.mktemp("arming")
            twin = Twin(robot, self._directory, options=row.options, by_hand=True)
            self.twin = self._twin.enter_context(twin)
        os.truncate(self.twin.log.path, 0)
        return Trial(row, self.twin, self._directory)

    def took_s(self, row: Row) -> float:
        """Return the duration of the verb without a kill."""
        if str(row) not in self._took_s:
            self._took_s[str(row)] = duration_s(row, self.trial(row))
        return self._took_s[str(row)]

    def close(self) -> None:
        self._twin.close()


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Bench]:
    made = Bench(tmp_path_factory)
    yield made
    made.close()


def duration_s(row: Row, trial: Trial) -> float:
    try:
        began_s = time.monotonic()
        trial.begin()
        answer = trial.line(60.0)
        took_s = time.monotonic() - began_s
        assert answer["status"] in ("success", "None"), answer
        assert (row.begun or row.energised)(trial), f"the verb does nothing: {trial.log.story(0)}"
        trial.kill("caller")
        ends(trial, GONE_S, "the caller killed")
        return took_s
    finally:
        trial.end()


def ends(trial: Trial, within_s: float, story: str) -> None:
    """Wait until no process of the tree is left except the caller.

    The time for which a process only waits for a processor does not count. On a starved machine, a
    root may not have begun to run.
    """
    began_s = time.monotonic()
    before: dict[int, float] = {}
    while left := {role: pid for role, pid in trial.roles().items() if role != "caller"}:
        waited_s = max(queued_s(pid) - before.setdefault(pid, queued_s(pid)) for pid in left.values())
        took_s = time.monotonic() - began_s
        assert took_s < within_s + waited_s, f"{left.keys()} still there after {took_s:g} s, {story}"
        time.sleep(0.01)


def queued_s(pid: int) -> float:
    """Return for how long a process has waited for a processor since its start (s)."""
    try:
        return int(Path(f"/proc/{pid}/schedstat").read_text().split()[1]) / 1e9
    except OSError:  # the process has ended
        return 0.0


@pytest.mark.parametrize(("row", "victim", "moments"), CASES)
def test_saf_021_nothing_is_energised_after_a_kill_during_the_verb(
    row: Row, victim: str, moments: int, bench: Bench
) -> None:
    took_s, late_s = bench.took_s(row), driver_of(row.robot).late_s
    for number in range(moments):
        trial = bench.trial(row)
        try:
            is_queued = row.queue_s and number == 0
            after_s = QUEUED * row.queue_s if is_queued else (number + 0.5) / moments * took_s
            began_ns = time.monotonic_ns()
            trial.begin()
            time.sleep(after_s)
            killed = trial.kill(victim)
            story = f"{killed} killed {after_s * 1e3:.0f} ms after {row.verb}"
            if "caller" in killed or "root" in killed:
                ends(trial, GONE_S + late_s, story)
            else:  # The tree still runs, and a state that it has confirmed must last.
                trial.line(60.0)
                trial.begin("stop")
                answer = trial.line(60.0)
                assert answer["status"] == "success", (story, answer)
            assert not row.energised(trial), f"{story}: energised. {trial.log.story(began_ns)}"
            time.sleep(late_s + 0.2)
            assert not row.energised(trial), f"{story}: energised later. {trial.log.story(began_ns)}"
            assert trial.late_enables() == 0, f"{story}: {trial.log.story(began_ns)}"
        finally:
            trial.end()
