"""Check a driver: a list of named checks that every driver must pass.

A package with its own driver tests it in ten lines:

    import pytest
    from strands_actors.testing import conformance
    from my_package import MyDriver

    @pytest.mark.parametrize("check", conformance(MyDriver), ids=str)
    def test_my_driver(check):
        check()

The pure checks take no time. The checks with a simulated robot (twin) start processes, and take a second or two
each.
"""

from __future__ import annotations

import atexit
import contextlib
import json
import math
import subprocess
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, is_dataclass
from functools import partial
from pathlib import Path
from typing import Any

import msgspec

from strands_actors.contract.contract_version import unsupported_contract
from strands_actors.contract.driver import Candidate, Driver, GateState
from strands_actors.contract.fallbacks import check_fallbacks
from strands_actors.contract.loading import load
from strands_actors.contract.wire import Observation, StopChannel, Wire
from strands_actors.kernel.messages import Refused
from strands_actors.kernel.processes.interpreter import PYTHON, environment
from strands_actors.kernel.processes.process import exists
from strands_actors.supervisors.gate.messages import MAX_LIFETIME_S
from strands_actors.supervisors.loading import describe_driver, load_driver

from .bench import Bench, driver_of, usual_motion
from .cells import run_cell
from .faults import Cell, Faults, Victims, cells_of
from .pairs import pairs_of
from .registering import class_path_of
from .twin import Twin

CELLS = (
    (Victims.CALLER, Faults.KILL),
    (Victims.POLICY, Faults.KILL),
    (Victims.WIRE, Faults.KILL),  # the stop channel must stop the robot
    (Victims.WIRE, Faults.FREEZE),
    (Victims.ROOT, Faults.KILL),
    (Victims.ROOT, Faults.FREEZE),
    (Victims.TWIN, Faults.LINK_LOSS),
)
"""The kill cells that the checks run: the hardest ones."""

MAX_HZ = 1000.0
MAX_BOUND_S = 1.0


@dataclass(frozen=True)
class Result:
    """The result of one check."""

    name: str
    passed: bool
    detail: str
    proves: tuple[str, ...] = ()


@dataclass(frozen=True)
class Check:
    """One check of a driver. A call of it raises ``AssertionError`` if it finds a defect.

    Attributes:
        name: What the check verifies, in a few words.
        run: The function that checks. Its result is a detail to show.
        proves: Ids of the requirements in docs/safety.md that the check proves.
    """

    name: str
    run: Callable[[], str | None] = field(compare=False)
    proves: tuple[str, ...] = ()

    def __call__(self) -> None:
        """Run the check. Raise ``AssertionError`` with the defect."""
        self.run()

    def __str__(self) -> str:
        return self.name

    def result(self) -> Result:
        """Run the check, and return its result. If the driver's code raises any exception, the check has failed."""
        try:
            detail = self.run() or ""
        # The driver's code may raise anything.
        except Exception as error:
            type_name = "" if isinstance(error, AssertionError) else f"{type(error).__name__}: "
            return Result(self.name, False, f"{type_name}{error}", self.proves)
        return Result(self.name, True, detail, self.proves)


def check_driver(
    cls: type[Driver],
    robot: str | None = None,
    *,
    good: Mapping[str, float] | None = None,
    twin: bool = True,
    far: float | None = None,
) -> list[Result]:
    """Run every check of ``conformance``, and return the results."""
    return [check.result() for check in conformance(cls, robot, good=good, twin=twin, far=far)]


def conformance(
    cls: type[Driver],
    robot: str | None = None,
    *,
    good: Mapping[str, float] | None = None,
    twin: bool = True,
    far: float | None = None,
) -> list[Check]:
    """Return the checks of one driver class with one of its robots.

    Args:
        cls: The driver class.
        robot: One of its robots. By default the first one.
        good: An action that the driver accepts when nothing is wrong. By default the first axis at 0. For a driver
            that accepts only actions with all axes, all axes at 0.
        twin: False leaves out the checks that start processes.
        far: How far the first axis of the simulated robot may be moved, in the axis' units.
    """
    subject = _Subject(cls, robot or cls.SUPPORTED_ROBOTS[0], good, twin)
    checks = [
        Check("declares itself", subject.declares),
        Check("travels between processes", subject.travels),
        Check("names its wire and stop channel", subject.names),
        Check("every reason leads to a safe state", subject.fallbacks, ("SAF-003",)),
        Check("timing is sane", subject.timing, ("SAF-001", "SAF-004")),
        Check("says what its firmware does alone", subject.firmware, ("SAF-013",)),
        Check("refuses unknown options", subject.options),
        Check("accepts a good action, the same each time", subject.accepts, ("SAF-014",)),
        Check("refuses unknown names", subject.unknown, ("SAF-014",)),
        Check("refuses what is no finite number", subject.not_finite, ("SAF-014",)),
        Check("refuses what is far out of range", subject.out_of_range, ("SAF-014",)),
        Check("refuses one axis under two spellings", subject.both_spellings, ("SAF-014",)),
        Check("refuses an empty action", subject.empty, ("SAF-014",)),
        Check("refuses when nothing was read for long", subject.stale, ("SAF-012", "SAF-014")),
    ]
    cells = [cell for cell in cells_of(subject.driver) if (cell.victim, cell.fault) in CELLS and not cell.why_not]
    if twin:
        bench = _SharedBench(subject, far, len(cells) + 1)
        checks.append(
            Check("the twin serves, the robot moves, stops and resumes", subject.lives, ("SAF-005", "SAF-011"))
        )
        checks.append(Check("every process that it runs is a victim", bench.victims, ("SAF-003", "SAF-016")))
        checks += [Check(f"kill cell {cell}", partial(bench.check, cell), cell.proves) for cell in cells]
    return checks


class _SharedBench:
    """The bench (simulated robot and script) that all kill cells of a driver share.

    A kill cell breaks one process of the moving robot.

    The first cell opens the bench. The last cell closes it. It is also closed by the first cell of another driver,
    by ``close_bench``, and at the end of the process.
    """

    opened: _SharedBench | None = None
    """The open bench. There is only one at a time, since its robot moves, and computes, until the bench is
    closed."""

    def __init__(self, subject: _Subject, far: float | None, users: int) -> None:
        self._new = partial(Bench, subject.robot, subject.cls, far)
        self._users = users
        self._bench: Bench | None = None

    @contextlib.contextmanager
    def _used(self) -> Iterator[Bench]:
        self._users -= 1
        try:
            if self._bench is None:
                close_bench()
                self._bench = self._new().__enter__()
                _SharedBench.opened = self
                atexit.register(self.close)
            yield self._bench
        finally:
            if self._users <= 0:
                self.close()

    def victims(self) -> str:
        """Check that ``Robot.tree()`` lists every process of the robot, so that the matrix can break each.

        The processes are found by their environment variables, independent of the process that started them.
        """
        with self._used() as bench:
            caller = bench.moving(usual_motion(bench.driver))
            roles = caller.pids()
            strangers = sorted(set(bench.processes()) - set(roles.values()))
            names = [Path(f"/proc/{pid}/comm").read_text().strip() for pid in strangers if exists(pid)]
        assert not names, f"the tree does not show {', '.join(names)}"
        members = {member for pair in pairs_of(bench.driver, roles) for member in pair.members}
        missing = roles.keys() - members - {Victims.TWIN}
        assert not missing, f"no pair has {', '.join(missing)}"
        return ", ".join(roles)

    def check(self, cell: Cell) -> str:
        with self._used() as bench:
            outcome = run_cell(cell, bench)
        assert outcome.all_motors, f"no frame that brings all motors to {outcome.safe_state}"
        assert outcome.setpoints_after == 0, f"{outcome.setpoints_after} setpoints after the safe frame"
        late = f"safe after {outcome.safe_ms:.0f} ms, bound {outcome.bound_ms:.0f} ms"
        assert outcome.on_time, f"{late}, of which its processes stood in line for {outcome.stood_ms:.0f} ms"
        took = f"after {outcome.safe_ms:.1f} ms (bound {outcome.bound_ms:.0f} ms)"
        return f"{outcome.safe_state} {took}, 0 setpoints after"

    def close(self) -> None:
        bench, self._bench = self._bench, None
        if bench is not None:
            _SharedBench.opened = None
            atexit.unregister(self.close)
            bench.__exit__(None, None, None)


def close_bench() -> None:
    """Close the bench of a driver's kill cells, if some of the cells are not run here.

    A kill cell is a check that breaks one process of a moving robot.

    Some cells are not run here with pytest's ``-k``, or if another worker process of pytest runs them.
    """
    if _SharedBench.opened is not None:
        _SharedBench.opened.close()


class _Subject:
    """One robot of the driver class that is checked. The methods are the checks."""

    def __init__(self, cls: type[Driver], robot: str, good: Mapping[str, float] | None, has_twin: bool) -> None:
        self.cls = cls
        self.has_twin = has_twin
        self.robot = robot
        self.driver = driver_of(robot, cls)
        named = self.driver.axes if cls.WHOLE_ACTIONS else self.driver.axes[:1]
        self.good = dict(good) if good is not None else dict.fromkeys(named, 0.0)

    # -- declarations

    def declares(self) -> None:
        cls, driver = self.cls, self.driver
        why_not = unsupported_contract(cls)
        assert not why_not, why_not
        assert self.robot in cls.SUPPORTED_ROBOTS, f"SUPPORTED_ROBOTS lacks {self.robot}"
        assert cls.PORT_KIND in ("serial", "address"), f"PORT_KIND is {cls.PORT_KIND!r}"
        strangers = [name for name, target in cls.ALIASES.items() if target not in cls.SUPPORTED_ROBOTS]
        assert not strangers, f"ALIASES of robots that are not served: {', '.join(strangers)}"
        assert driver.axes, "axes is empty"
        assert len(set(driver.axes)) == len(driver.axes), "axes has a name twice"
        assert len(driver.ids) == len(driver.axes), f"{len(driver.axes)} axes, {len(driver.ids)} ids"
        assert driver.unit, "unit is empty"
        assert driver.gates, "there is no gate at all"
        assert all(text for text in cls.OPTIONS.values()), "an option of OPTIONS has no text"
        assert not self.has_twin or callable(load(cls.TWIN)), f"TWIN is {cls.TWIN!r}, not module:function"

    def travels(self) -> None:
        """Check that a driver can be built in another process from the name of its class and plain options."""
        options = self.cls.resolve(self.robot, {})
        text = json.dumps(describe_driver(self.cls, self.robot, "", options))
        again = load_driver(json.loads(text))
        assert type(again) is self.cls, "its class cannot be imported by name: define it at the top of a module"
        assert (again.axes, again.ids) == (self.driver.axes, self.driver.ids), "built anew it has other axes"

    def names(self) -> None:
        """Check that the classes that a driver names exist, and that its config is frozen.

        The connection to the robot gets only the config, and not the driver. So a process that opens a connection
        need not load the modules that the driver needs.
        """
        cls = self.cls
        for member, base_class in (("WIRE", Wire), ("STOP_CHANNEL", StopChannel)):
            name = getattr(cls, member)
            if not name:
                continue  # the driver overrides the method that makes this object
            named = load(name)
            assert isinstance(named, type) and issubclass(named, base_class), (
                f"{member} is {name!r}, no {base_class.__name__}"
            )
            config = getattr(self.driver, "config", None)
            assert _is_frozen(config), f"config is {config!r}, no frozen struct"

    def fallbacks(self) -> str:
        check_fallbacks(self.robot, self.driver.fallbacks)
        return ", ".join(dict.fromkeys(self.driver.fallbacks.values()))

    def timing(self) -> None:
        timing, period_s = self.driver.timing, 1.0 / self.driver.timing.control_hz
        assert 0 < timing.control_hz <= MAX_HZ, f"control_hz is {timing.control_hz}"
        assert timing.keepalive_s > 0, f"keepalive_s is {timing.keepalive_s}"
        ttl_s = timing.stream_ttl_s
        assert period_s <= ttl_s <= MAX_LIFETIME_S, f"stream_ttl_s is {ttl_s}, a period is {period_s:.4f}"
        assert period_s <= timing.state_ttl_s, f"state_ttl_s is {timing.state_ttl_s}, a period is {period_s:.4f}"
        oneshot_s = timing.oneshot_ttl_s
        assert oneshot_s is None or 0 < oneshot_s <= MAX_LIFETIME_S, f"oneshot_ttl_s is {oneshot_s}"
        assert timing.arm_s > 0, f"arm_s is {timing.arm_s}"
        assert timing.silent_s >= 0, f"silent_s is {timing.silent_s}"
        assert 0 < self.driver.bound_s <= MAX_BOUND_S, f"bound_s is {self.driver.bound_s}"

    def firmware(self) -> str:
        remedy = "Write what the firmware does when all processes have ended"
        assert self.driver.firmware_watchdog, f"firmware_watchdog is empty. {remedy}"
        return self.driver.firmware_watchdog

    def options(self) -> None:
        try:
            self.cls.resolve(self.robot, {"no_such_option": 1})
        except (TypeError, ValueError) as refusal:
            assert "no_such_option" in str(refusal), f"the refusal does not name it: {refusal}"
            return
        # ``Robot()`` refuses every option that is not in ``OPTIONS``. So such an option never reaches
        # ``resolve()``.
        assert "no_such_option" not in self.cls.OPTIONS

    # -- checks of ``parse`` and of the gates

    def answer(self, action: Mapping[str, Any], state: GateState | None = None) -> Candidate | Refused:
        """Answer an action as the robot's gate would, with the first refusal or the accepted candidate.

        Check the driver's conditions (they must be true while the robot is commanded), parse the action, and check
        its range and speed (the driver's gates).
        """
        state = state or self.state()
        for condition in self.driver.conditions:
            refusal = condition.check(state.observation, state.now_ns)
            if refusal is not None:
                return refusal
        candidate = self.driver.parse(action, state)
        if isinstance(candidate, Refused):
            return candidate
        for gate in self.driver.gates:
            refusal = gate(candidate, state)
            if refusal is not None:
                return refusal
        return candidate

    def state(self, age_ns: int = 0) -> GateState:
        now_ns = 10**12
        count = len(self.driver.axes)
        t_ns = now_ns - age_ns
        observation = Observation(t_ns, (0.0,) * count, (t_ns,) * count)
        return GateState(now_ns, observation, (0.0,) * count, t_ns, False)

    def refuses(self, action: Mapping[str, Any], state: GateState | None = None) -> Refused:
        shown = ", ".join(f"{key}: {value!r}" for key, value in action.items())
        answer = self.answer(action, state)
        assert isinstance(answer, Refused), f"{{{shown}}} is accepted"
        assert answer.code, f"{{{shown}}}: the refusal has no code"
        assert answer.reason, f"{{{shown}}}: the refusal has no reason"
        return answer

    def accepts(self) -> None:
        candidate = self.driver.parse(self.good, self.state())
        assert isinstance(candidate, Candidate), f"{self.good} is refused: {candidate.text}. Give good=..."
        assert candidate.named, f"{self.good} names no axis"
        assert len(candidate.values) >= len(self.driver.axes), "the candidate is no whole target"
        assert self.driver.parse(self.good, self.state()) == candidate, "parse is not pure: it answers differently"

    def unknown(self) -> None:
        refusal = self.refuses({"no_such_axis": 0.0})
        assert refusal.remedy, "the refusal does not say what would be accepted"
        self.refuses({**self.good, "no_such_axis": 0.0})
        self.refuses({"": 0.0})

    def not_finite(self) -> None:
        for key in self.good:
            for value in (math.nan, math.inf, -math.inf, "fast", None, [1.0], True):
                self.refuses({**self.good, key: value})

    def out_of_range(self) -> None:
        for key in self.good:
            self.refuses({**self.good, key: 1e9})
            self.refuses({**self.good, key: -1e9})

    def both_spellings(self) -> None:
        for key, value in self.good.items():
            self.refuses({**self.good, key: value, f"{key}.pos": value})

    def empty(self) -> None:
        self.refuses({})

    def stale(self) -> None:
        age_s = 10 * self.driver.timing.state_ttl_s
        self.refuses(self.good, self.state(round(age_s * 1e9)))

    # -- checks with the simulated robot

    def lives(self) -> str:
        # Close the previous driver's bench. If some of its cells were not run, it is open and its robot still
        # moves.
        close_bench()
        with (
            tempfile.TemporaryDirectory(prefix="sa-") as directory,
            Twin(self.robot, Path(directory), driver=self.cls) as twin,
        ):
            settings = {"robot": self.robot, "port": twin.port, "driver": class_path_of(self.cls)}
            done = subprocess.run(
                [*PYTHON, "-m", "strands_actors.testing.life", json.dumps(settings)],
                capture_output=True,
                text=True,
                timeout=60.0,
                check=False,
                env=environment(STRANDS_ACTORS_RUN=f"{directory}/run", STRANDS_ACTORS_DATA=f"{directory}/data"),
            )
            assert done.returncode == 0, (done.stderr.strip() or done.stdout.strip()).splitlines()[-1]
            entries = list(twin.log.entries())
        assert any(entry.kind == "safe" for entry in entries), "the twin's log has no frame of kind safe"
        assert any(entry.kind == "setpoint" for entry in entries), "the twin's log has no frame of kind setpoint"
        return done.stdout.strip()


def report(results: Sequence[Result]) -> Iterator[str]:
    """Yield one line for each result of a check, for people."""
    for result in results:
        mark = "ok  " if result.passed else "FAIL"
        yield f"{mark}  {result.name}{f': {result.detail}' if result.detail else ''}"


def _is_frozen(config: object) -> bool:
    if isinstance(config, msgspec.Struct):
        return config.__struct_config__.frozen
    return is_dataclass(config) and getattr(type(config), "__dataclass_params__").frozen  # noqa: B009  # mypy
