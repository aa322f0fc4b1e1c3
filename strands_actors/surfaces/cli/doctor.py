"""``doctor``: check whether this computer can run robots. Each finding has its remedy in one line.

* ``ok``: nothing to do.
* ``note``: nothing to repair. An extra, which is optional, is not installed.
* ``weak``: robots run, but something works less well.
* ``broken``: something is missing that every robot needs. The exit code is 1.
"""

from __future__ import annotations

import grp
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from importlib import metadata
from typing import Any

from strands_actors.caller.processes import process_one
from strands_actors.caller.processes.run_directory import MAX_SOCKET_PATH, notes, run_dir
from strands_actors.contract.extras import missing
from strands_actors.kernel.processes.interpreter import PYTHON

from .packages import DISTRIBUTION, install_command, missing_requirements

OK, NOTE, WEAK, BROKEN = "ok", "note", "weak", "broken"
PYTHONS = ((3, 11), (3, 14))
"""The oldest and newest version that this package is tested with."""
GL_S = 20.0
"""Timeout for making a picture, in seconds. A GL driver that hangs is as bad as a missing one."""
LOAD = "load"


@dataclass(frozen=True)
class Check:
    """One finding. ``state`` is ``ok``, ``note``, ``weak`` or ``broken``, and ``text`` describes it."""

    name: str
    state: str
    text: str
    remedy: str = ""

    def as_json(self) -> dict[str, str]:
        return {"name": self.name, "state": self.state, "found": self.text, "remedy": self.remedy}


def run(as_json: bool) -> int:
    """Print every finding. Return 1 if something that every robot needs is broken, else 0."""
    checks = list(examine())
    healthy = all(check.state != BROKEN for check in checks)
    if as_json:
        print(json.dumps({"ok": healthy, "checks": [check.as_json() for check in checks]}))
    else:
        _show(checks)
    return 0 if healthy else 1


def examine() -> Iterator[Check]:
    """Yield the findings of every check. If a check raises an exception, this is also a finding."""
    parts: tuple[Callable[[], Iterator[Check]], ...] = (
        check_python,
        check_kernel,
        check_scheduling,
        check_load,
        check_memory,
        check_process_one,
        check_directory,
        check_zenoh,
        check_serial,
        check_gl,
        check_drivers,
        check_extras,
        check_robots,
    )
    for part in parts:
        name = part.__name__.removeprefix("check_")
        try:
            yield from part()
        except Exception as error:  # On an unusual computer a check may fail in any way.
            yield Check(
                name, BROKEN, f"{type(error).__name__}: {error}", "report this: doctor has no remedy for it"
            )


def check_python() -> Iterator[Check]:
    version, (oldest, newest) = sys.version_info[:2], PYTHONS
    text = f"{sys.version.split()[0]} at {sys.executable}"
    supported = f"{oldest[0]}.{oldest[1]} to {newest[0]}.{newest[1]}"
    if oldest <= version <= newest:
        yield Check("python", OK, text)
    else:
        yield Check("python", BROKEN, text, f"use Python {supported}: python3.11 -m venv .venv")


def check_kernel() -> Iterator[Check]:
    from strands_actors.kernel.clock import has_timerfd

    if has_timerfd():
        yield Check("timerfd", OK, "timers are 0.05 ms late")
    else:
        yield Check(
            "timerfd", WEAK, "missing, so timers are rounded to milliseconds", "run on Linux for exact timing"
        )
    try:
        os.close(os.pidfd_open(os.getpid()))
    except (AttributeError, OSError) as error:
        yield Check(
            "pidfd",
            WEAK,
            f"missing ({error}), so the end of a process is seen 5 ms late",
            "run on Linux 5.3 or newer",
        )
    else:
        yield Check("pidfd", OK, "the end of a process is seen at once")


def check_scheduling() -> Iterator[Check]:
    from strands_actors.kernel.health.realtime import may_lock_memory, may_run_first

    if not hasattr(os, "sched_setscheduler"):
        yield Check(
            "scheduling", WEAK, "this system has no SCHED_FIFO (real-time priority)", "close other programs"
        )
        return
    user = os.environ.get("USER") or str(os.getuid())
    grant = (
        rf"printf '{user} - rtprio 20\n{user} - memlock unlimited\n' | "
        "sudo tee /etc/security/limits.d/robots.conf, then log in again "
        "(systemd: LimitRTPRIO=20, LimitMEMLOCK=infinity; docker: --ulimit rtprio=20 --ulimit memlock=-1; "
        "never as its process 1: docs/safety-faults.md)"
    )
    if len(os.sched_getaffinity(0)) < 2:
        yield Check(
            "scheduling",
            WEAK,
            "this computer has one core, so a robot's processes do not run before other programs",
            "use two cores",
        )
    elif may_run_first():
        yield Check("scheduling", OK, "a robot's processes run before other programs (SCHED_FIFO)")
    else:
        yield Check("scheduling", WEAK, "SCHED_FIFO is not permitted, so timers are late on a busy computer", grant)
    if may_lock_memory():
        yield Check("memory lock", OK, "a robot's processes stay in memory (mlockall)")
    else:
        yield Check(
            "memory lock", WEAK, "mlockall is not permitted, so a robot's processes may wait for the disk", grant
        )


def check_load() -> Iterator[Check]:
    """Check whether other programs leave enough processor time for a robot."""
    from strands_actors.kernel.health.busy import machine

    load = machine()
    if load.busy:
        remedy = "close other programs, or give the robot a computer that does nothing else: docs/safety-faults.md"
        yield Check(LOAD, WEAK, f"this computer is busy: {load.text}", remedy)
    else:
        yield Check(LOAD, OK, load.text)


def check_memory() -> Iterator[Check]:
    """Check whether the kernel kills other programs before a robot's processes when memory runs out."""
    from strands_actors.kernel.processes.identity import LAST, can_lower_oom_score

    may = can_lower_oom_score()
    if may is None:
        yield Check(
            "memory", WEAK, "this system does not report which processes it ends first when memory runs out"
        )
    elif may:
        yield Check(
            "memory", OK, f"when memory runs out, a robot's processes are ended last (oom_score_adj {LAST})"
        )
    else:
        yield Check(
            "memory",
            WEAK,
            "when memory runs out, the kernel may end a robot's processes as early as other programs",
            f"start the script with systemd and OOMScoreAdjust={LAST}, or give it CAP_SYS_RESOURCE",
        )


def check_process_one() -> Iterator[Check]:
    """Check whether a robot's processes survive the end of their script, so that they can stop the robot. In a
    container this depends on process 1."""
    result = process_one.describe()
    if result is None:
        return
    name, problem = result
    if problem:
        yield Check("process 1", WEAK, f"{name}: {problem}", process_one.REMEDY)
    else:
        yield Check("process 1", OK, f"{name}: a robot's processes outlive their script, as long as process 1 runs")


def check_directory() -> Iterator[Check]:
    try:
        path = run_dir()
        with tempfile.NamedTemporaryFile(dir=path):
            pass
    except OSError as error:
        yield Check("directory", BROKEN, str(error), "set STRANDS_ACTORS_RUN to a directory of your own, mode 700")
        return
    room = MAX_SOCKET_PATH - len(f"{path}/.root.sock".encode())
    if room < 16:
        yield Check(
            "directory",
            BROKEN,
            f"{path} is too long, so a robot's name may have at most {max(room, 0)} letters",
            "set STRANDS_ACTORS_RUN to a shorter path",
        )
    else:
        yield Check("directory", OK, f"{path}, only you can use it")


def check_zenoh() -> Iterator[Check]:
    import zenoh

    from strands_actors.kernel.channels.zenoh_mesh import config, unix_endpoint

    with tempfile.TemporaryDirectory(prefix="sa-") as directory:
        try:
            session: Any = zenoh.open(config([unix_endpoint(f"{directory}/doctor.sock")]))
            session.close()
        except Exception as error:  # Zenoh's errors are not OSErrors, and any failure is a finding.
            yield Check(
                "zenoh",
                BROKEN,
                f"a session cannot be opened: {error}",
                "pip install --force-reinstall eclipse-zenoh",
            )
            return
    yield Check("zenoh", OK, f"{metadata.version('eclipse-zenoh')}, a session can be opened (loopback only)")


def check_serial() -> Iterator[Check]:
    from serial.tools import list_ports

    # Leave out built-in serial ports that have no hardware.
    devices = (port for port in list_ports.comports() if port.hwid != "n/a")
    ports = sorted(devices, key=lambda port: str(port.device))
    usable = []
    for port in ports:
        if os.access(port.device, os.R_OK | os.W_OK):
            usable.append(f"{port.device} ({port.description})" if port.description else str(port.device))
            continue
        group = _group_of(port.device)
        yield Check(
            "serial",
            WEAK,
            f"{port.device} belongs to group {group}, and you may not open it",
            f"sudo usermod -aG {group} $USER, then log in again",
        )
    if usable:
        yield Check("serial", OK, ", ".join(usable))
    elif not ports:
        yield Check("serial", OK, "no serial device is plugged in")


def _group_of(path: str) -> str:
    gid = os.stat(path).st_gid
    try:
        return grp.getgrgid(gid).gr_name
    except KeyError:
        return str(gid)


_PICTURE = """
import mujoco
model = mujoco.MjModel.from_xml_string("<mujoco><worldbody><geom size='1'/></worldbody></mujoco>")
data = mujoco.MjData(model)
with mujoco.Renderer(model, 32, 32) as renderer:
    mujoco.mj_forward(model, data)
    renderer.update_scene(data)
    assert renderer.render().any()
"""


def check_gl() -> Iterator[Check]:
    """Check whether MuJoCo can render. Each backend is tried in a separate process, because a GL library
    cannot be replaced once it is loaded, and may crash."""
    if lacking := missing("pictures", "render()"):
        absent, _, remedy = lacking.partition(". ")
        yield Check("gl", NOTE, absent, remedy)
        return
    requested = os.environ.get("MUJOCO_GL")
    problems = []
    for backend in (requested,) if requested else ("egl", "osmesa"):
        try:
            done = subprocess.run(
                [*PYTHON, "-c", _PICTURE],
                env={**os.environ, "MUJOCO_GL": backend},
                capture_output=True,
                text=True,
                timeout=GL_S,
                check=False,
            )
        except subprocess.TimeoutExpired:
            problems.append(f"{backend}: no picture within {GL_S:g} s")
            continue
        if done.returncode == 0:
            yield Check("gl", OK, f"pictures with MUJOCO_GL={backend}")
            return
        problems.append(f"{backend}: {(done.stderr.strip().splitlines() or [f'code {done.returncode}'])[-1]}")
    yield Check(
        "gl",
        WEAK,
        f"render() makes no picture ({'; '.join(problems)})",
        "sudo apt install libegl1 libgl1-mesa-dri  (or libosmesa6 and MUJOCO_GL=osmesa)",
    )


def check_drivers() -> Iterator[Check]:
    import warnings

    from strands_actors import drivers

    with warnings.catch_warnings(record=True):  # Broken drivers also cause warnings, and are reported below.
        warnings.simplefilter("always")
        robots = drivers.list_native_drivers()
    for name, reason in sorted(drivers.broken_drivers().items()):
        ours = name in drivers.WIRES
        yield Check(
            "driver",
            BROKEN if ours else WEAK,
            f"{name} cannot be used: {reason}",
            f"pip install --force-reinstall {DISTRIBUTION}" if ours else f"update or remove the package of {name}",
        )
    yield Check("drivers", OK, f"{len(robots)} robots, {len(set(robots.values()))} drivers")


def check_extras() -> Iterator[Check]:
    """Check for missing packages: required packages, and those of the optional extras
    (``pip install 'strands-actors[...]'``)."""
    try:
        requirements = metadata.requires(DISTRIBUTION) or []
    except metadata.PackageNotFoundError:
        yield Check(
            "packages", WEAK, f"{DISTRIBUTION} runs from its source and is not installed", "pip install -e ."
        )
        return
    for extra, absent in missing_requirements(requirements).items():
        name = f"extra {extra}" if extra else "packages"
        if not absent:
            yield Check(name, OK, "installed")
        elif extra:
            yield Check(name, NOTE, "not installed", install_command(extra))
        else:
            remedy = f"pip install --force-reinstall {DISTRIBUTION}"
            yield Check(name, BROKEN, f"missing: {', '.join(absent)}", remedy)


def check_robots() -> Iterator[Check]:
    try:
        running = [f"{note.robot} (root {note.pid})" for note in notes()]
    except PermissionError:  # ``check_directory`` reports this.
        return
    yield Check("robots", OK, f"running: {', '.join(running)}" if running else "no robot of yours is running")


def _show(checks: list[Check]) -> None:
    from rich.console import Console
    from rich.text import Text

    styles = {OK: "green", NOTE: "cyan", WEAK: "yellow", BROKEN: "bold red"}
    console = Console()
    width = max(len(check.name) for check in checks)
    for check in checks:
        # A note is one line: it needs no remedy, and there may be many.
        text = f"{check.text}: {check.remedy}" if check.state == NOTE else check.text
        line = Text.assemble((f"{check.state:<7}", styles[check.state]), f"{check.name:<{width}}  {text}")
        console.print(line, soft_wrap=True)
        if check.remedy and check.state != NOTE:
            console.print(Text(f"{'':<7}{'':<{width}}  remedy: {check.remedy}", "dim"), soft_wrap=True)
    count = sum(check.state == BROKEN for check in checks)
    console.print(f"{count} broken" if count else _verdict(checks), style="bold")


def _verdict(checks: Sequence[Check]) -> str:
    """Return the last line of the output, for the case that nothing is broken."""
    if any(check.name == LOAD and check.state == WEAK for check in checks):
        return "nothing is missing, but this computer is too busy now"
    return "everything a robot needs is here"
