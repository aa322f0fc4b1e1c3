"""Record episodes from a page: one recorder process for each robot, which the page starts, commands and ends.

The recorder is the one of ``record_dataset``, in a separate process. If this server ends, the recorder's input
ends, and so does the recorder. An episode that was running then can be repaired.
"""

from __future__ import annotations

import math
import re
import signal
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal

import msgspec
import trio
from starlette.requests import Request
from starlette.routing import Route

from strands_actors.contract.extras import missing
from strands_actors.contract.shown import harmless
from strands_actors.kernel.processes.interpreter import PYTHON, environment
from strands_actors.kernel.processes.lines import lines_of
from strands_actors.surfaces.dataset.order import Event, Order

from .access import Role, Session
from .answers import Bad, body, order, robot_of

CHILD = "strands_actors.surfaces.dataset.child"
READY_S = 60.0
"""How long a recorder may take to start, on a slow computer with cameras."""
ANSWER_S = 60.0
"""How long an answer may take: a slow disk has to take an episode."""
LEAVE_S = 10.0
"""How long a recorder may take to end when this server ends."""
NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,63}")
"""The name of a dataset, which is the name of its folder."""


class OpenOrder(msgspec.Struct, forbid_unknown_fields=True):
    """Start a recorder. With an existing dataset, the episodes are added."""

    dataset: str
    task: str
    fps: int = 30
    cameras: tuple[str, ...] = ()


class PressOrder(msgspec.Struct, forbid_unknown_fields=True):
    """A button of the recorder. ``quit`` finishes a running episode and ends the recorder."""

    word: Literal["start", "finish", "discard", "again", "quit"]


class RecorderState(msgspec.Struct):
    """A recorder as the page shows it.

    Attributes:
        dataset: Name of the dataset.
        task: The task of the episodes.
        state: ``starting``, ``waiting``, ``recording`` or ``ended``.
        episode: Number of the running episode, or of the last one.
        seconds: Duration of the running episode until now.
        saved: Number of episodes that were saved.
        text: The last event.
    """

    dataset: str
    task: str
    state: str = "starting"
    episode: int = -1
    seconds: float = 0.0
    saved: int = 0
    text: str = ""


class Recorder:
    """A running recorder process.

    Args:
        process: The process.
        dataset: Name of the dataset.
        task: The task of the episodes.
        now_s: A clock that does not jump, in seconds.
    """

    def __init__(self, process: trio.Process, dataset: str, task: str, now_s: Callable[[], float]) -> None:
        self._process = process
        self._now_s = now_s
        self._state = RecorderState(dataset, task)
        self._began_s = math.nan
        self._number = 0
        self._answers: dict[int, trio.Event] = {}
        self._errors = b""
        self.is_ready = trio.Event()
        """Set when the recorder can start an episode, and when it has ended."""

    @property
    def has_ended(self) -> bool:
        return self._state.state == "ended"

    def shown(self) -> RecorderState:
        """Return the state for the page."""
        is_running = self._state.state == "recording"
        seconds = self._now_s() - self._began_s if is_running else 0.0
        return msgspec.structs.replace(self._state, seconds=round(seconds, 1))

    async def attend(self) -> None:
        """Follow the process until it ends. If this is cancelled, the process is ended."""
        try:
            async with trio.open_nursery() as nursery:
                nursery.start_soon(self._read_errors)
                await self._read_events()
            await self._process.wait()
        finally:
            with trio.CancelScope(shield=True, deadline=trio.current_time() + LEAVE_S):
                if self._process.returncode is None:
                    self._process.send_signal(signal.SIGINT)
                    await self._process.wait()
            if self._process.returncode is None:
                self._process.kill()
            self._end()

    async def press(self, word: str) -> None:
        """Send a command, and wait for its answer.

        Raises:
            Bad: The recorder has ended, or does not answer.
        """
        stdin = self._process.stdin
        assert stdin is not None
        self._number += 1
        answered = self._answers[self._number] = trio.Event()
        try:
            await stdin.send_all(f"{self._number} {word}\n".encode())
        except (trio.BrokenResourceError, trio.ClosedResourceError):
            raise Bad(409, f"The recorder has ended. {self._state.text}") from None
        with trio.move_on_after(ANSWER_S) as scope:
            await answered.wait()
        if scope.cancelled_caught:
            raise Bad(504, f"The recorder did not answer within {ANSWER_S:g} s. Look at the disk.")

    async def _read_events(self) -> None:
        stdout = self._process.stdout
        assert stdout is not None
        async for line in lines_of(stdout):
            self._take(msgspec.json.decode(line, type=Event))

    async def _read_errors(self) -> None:
        stderr = self._process.stderr
        assert stderr is not None
        async for piece in stderr:
            self._errors = (self._errors + piece)[-4096:]

    def _take(self, event: Event) -> None:
        state = self._state
        match event.type:
            case "alive":
                return
            case "ready":
                state.state = "waiting"
                self.is_ready.set()
            case "started":
                state.state, state.episode, self._began_s = "recording", event.episode, self._now_s()
            case "saved":
                state.state, state.episode, state.saved = "waiting", event.episode, state.saved + 1
            case "discarded":
                state.state = "waiting"
        state.text = harmless(event.line)
        if (answered := self._answers.pop(event.command_number, None)) is not None:
            answered.set()

    def _end(self) -> None:
        self._state.state = "ended"
        if self._errors:
            self._state.text = harmless(self._errors.decode(errors="replace").strip())
        self.is_ready.set()
        for answered in self._answers.values():
            answered.set()


class Recorders:
    """The recorders that pages have started.

    Args:
        folder: Folder of the datasets.
        now_s: A clock that does not jump, in seconds.
    """

    def __init__(self, folder: Path, now_s: Callable[[], float]) -> None:
        self._folder = folder
        self._now_s = now_s
        self._recorders: dict[str, Recorder] = {}

    def routes(self) -> list[Route]:
        return [
            Route("/robots/{robot}/recorder", order(self._look, Role.VIEWER), methods=["GET"]),
            Route("/robots/{robot}/recorder/open", order(self._open, Role.OPERATOR), methods=["POST"]),
            Route("/robots/{robot}/recorder/press", order(self._press, Role.OPERATOR), methods=["POST"]),
        ]

    async def run(self) -> None:
        """Attend to the recorders until cancelled. Then they are ended."""
        async with trio.open_nursery() as self._nursery:
            await trio.sleep_forever()

    async def _look(self, request: Request, session: Session) -> dict[str, Any]:
        recorder = self._recorders.get(robot_of(request))
        return {"recorder": None if recorder is None else recorder.shown()}

    async def _open(self, request: Request, session: Session) -> dict[str, Any]:
        robot, options = robot_of(request), await body(request, OpenOrder)
        if reason := missing("dataset", "recording"):
            raise Bad(409, reason)
        if not NAME.fullmatch(options.dataset):
            raise Bad(400, "A dataset has a name of 1 to 64 letters, digits, dots and dashes, such as pick-cube.")
        if not options.task.strip():
            raise Bad(400, "The task is missing. Give a sentence, such as: pick the cube up.")
        before = self._recorders.get(robot)
        if before is not None and not before.has_ended:
            raise Bad(409, f"A recorder of {robot} runs already. End it first.")
        recording = Order(robot, str(self._folder / options.dataset), options.task, options.fps, options.cameras)
        await trio.Path(self._folder).mkdir(parents=True, exist_ok=True)
        process = await trio.lowlevel.open_process(
            [*PYTHON, "-m", CHILD, msgspec.json.encode(recording).decode()],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            env=environment(),
            start_new_session=True,  # Ctrl-C goes to this server, which then ends the recorder.
        )
        recorder = self._recorders[robot] = Recorder(process, options.dataset, options.task, self._now_s)
        self._nursery.start_soon(recorder.attend)
        with trio.move_on_after(READY_S):
            await recorder.is_ready.wait()
        return {"recorder": recorder.shown()}

    async def _press(self, request: Request, session: Session) -> dict[str, Any]:
        robot, pressed = robot_of(request), await body(request, PressOrder)
        recorder = self._recorders.get(robot)
        if recorder is None or recorder.has_ended:
            raise Bad(409, f"No recorder of {robot} runs. Start one first.")
        await recorder.press(pressed.word)
        return {"recorder": recorder.shown()}
