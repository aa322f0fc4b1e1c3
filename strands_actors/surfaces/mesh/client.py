"""Everybody else on the mesh: who watches, commands, stops. On trio.

async with open_mesh() as mesh:
    for outcome in await mesh.estop():
        print(outcome.robot, outcome.outcome)
"""

from __future__ import annotations

import contextlib
import getpass
import itertools
import os
import re
import secrets
import time
from collections.abc import AsyncIterator, Callable, Iterator
from typing import Any, NamedTuple

import msgspec
import trio
import zenoh

from strands_actors.caller.background import open_background
from strands_actors.caller.strays import strays
from strands_actors.kernel.channels.pubsub import PubSub, Received
from strands_actors.kernel.clock import NS
from strands_actors.kernel.health import busy
from strands_actors.kernel.messages import Refused
from strands_actors.kernel.refusals import Code
from strands_actors.supervisors.mesh import schemas as mesh_json
from strands_actors.supervisors.mesh.schemas import ESTOP_ANSWER_S, Command, Response, encode, schema

from .config import MeshConfig
from .outcome import Outcome, outcome_of, result_of
from .sessions import EVERYBODY, LOOK_S, OTHERS, Sessions
from .signing import patience_s, signed

AWAY_S = 0.004
"""For an e-stop to be on the wires of this host. Who waits for its outcomes before that takes a
processor from it: a quarter of 2.8 ms, on two."""
ANSWER_S = 0.5
STOP_S = 3.0
"""Unless the robot says meanwhile that it has heard, and takes longer."""
BEGIN_S = 2.0
"""Within this time a policy has begun, or a pose was taken up, or nothing of it will be."""
PRESENCE_S = 1.5
"""Robots say twice a second that they are there; two times one may be missed."""
CLOCK_AGE_S = 10.0
"""A clock is read again when the last reading is older."""

_decode_response = msgspec.json.Decoder(Response).decode
_COMMAND = schema("command")


class Reading(msgspec.Struct, frozen=True):
    """A robot's clock, as read from here: its offset lies between the two. ``name``: how it knows
    the reading."""

    name: str
    lowest_ns: int
    highest_ns: int
    at_ns: int

    def deadline(self, at_ns: int) -> int:
        """Return a time of ours in the robot's, never later than meant."""
        return at_ns + self.lowest_ns


class Pressed(NamedTuple):
    """An e-stop that has been ordered, and from whom answers are expected."""

    turn: str
    by: str
    robot: str  # "*": every one
    answers: trio.MemoryReceiveChannel[Response]
    appeared: trio.Event
    sessions: list[PubSub]


class MeshClient:
    """``now_ns``: this host's clock; another one for tests."""

    def __init__(
        self, config: MeshConfig, nursery: trio.Nursery, now_ns: Callable[[], int] = time.monotonic_ns
    ) -> None:
        user = re.sub(r"[^A-Za-z0-9_-]", "-", getpass.getuser())[:32] or "user"
        self.sender = f"{config.own_prefix or user + '-'}{os.getpid()}-{secrets.token_hex(3)}"
        self._proof = secrets.token_hex(16)
        self.now_ns = now_ns
        self.sessions = Sessions(config, nursery, self._on_join)
        self._reaches_hosts = bool(config.connects)
        self._turns = itertools.count(1)
        self._waiting: dict[str, trio.MemorySendChannel[Response]] = {}
        self._clocks: dict[str, Reading] = {}
        self.unusable = ""
        """Why the configuration that was given could not be used; empty: it is."""

    def _on_join(self, session: PubSub) -> None:
        session.get_ready(mesh_json.ESTOP_KEY, _COMMAND)
        responses = mesh_json.response_key(self.sender, "*", "*")
        session.subscribe(responses, lambda received: self._on_response(session, received))

    # -- who is there

    @property
    def robots(self) -> list[str]:
        """Return those that are on the mesh, and those of this user that should be."""
        return self.sessions.robots

    async def settle(self, within_s: float = LOOK_S) -> None:
        """Return when every robot that is expected is there, and others have had the time to
        appear."""
        await self.sessions.settle(within_s)

    def is_there(self, robot: str) -> bool:
        return robot in self.sessions.via

    def subscribe(self, key: str, handler: Callable[[Received], None]) -> None:
        """Call ``handler`` for each sample, of robots that come later too."""
        self.sessions.subscribe(key, handler)

    # -- asking

    async def request(
        self, robot: str, command: Command | dict[str, Any], within_s: float = ANSWER_S
    ) -> dict[str, Any] | Refused:
        """Send one command; its result."""
        return await self._ask(robot, mesh_json.key(robot, "cmd"), {"command": command}, within_s)

    async def stop(self, robot: str, by: str = "", within_s: float = STOP_S) -> Outcome:
        """Make one robot safe. Not by its command key: that may be flooded."""
        body = {"command": mesh_json.Stop(by=signed(by))}
        answer = await self._ask(robot, mesh_json.BROADCAST_KEY, body, within_s)
        if isinstance(answer, Refused):
            return Outcome(robot, "unreachable", answer.text)
        return outcome_of(robot, answer)

    async def resume(self, robot: str, by: str = "", within_s: float = 12.0) -> dict[str, Any] | Refused:
        """Lift a lockout and energise at the measured position. Starts no motion."""
        clock = await self.clock(robot)
        if isinstance(clock, Refused):
            return clock
        deadline_ns = clock.deadline(self.now_ns() + round(ANSWER_S * NS))
        return await self.request(
            robot, mesh_json.Resume(clock=clock.name, deadline_ns=deadline_ns, by=signed(by)), within_s
        )

    async def post(self, robot: str, command: Command) -> None:
        """Send one command that is not answered."""
        via = self.sessions.via.get(robot)
        if via is not None:
            self._send(via, mesh_json.key(robot, "cmd"), robot, self._new_turn(), {"command": command})

    async def dated(
        self,
        robot: str,
        make: Callable[[str, int], Command | dict[str, Any]],
        ttl_s: float,
        within_s: float = ANSWER_S,
    ) -> dict[str, Any] | Refused:
        """Send a command that must not be obeyed later than in ``ttl_s``; its result. ``make`` gets
        the name of the robot's clock, and the deadline in its time."""
        answer: dict[str, Any] | Refused = Refused(Code.CLOCK, "the robot's clock is not known")
        for _ in range(2):
            clock = await self.clock(robot)
            if isinstance(clock, Refused):
                return clock
            deadline_ns = clock.deadline(self.now_ns() + round(ttl_s * NS))
            answer = await self.request(robot, make(clock.name, deadline_ns), within_s)
            if not isinstance(answer, Refused) or answer.code != Code.CLOCK:
                break
            self.forget_clock(robot)  # it was started anew
        return answer

    async def clock(self, robot: str) -> Reading | Refused:
        """Return the robot's clock. The answer leaves at once while the question may have waited,
        so it is the way back that bounds the error of ``deadline``."""
        known = self._clocks.get(robot)
        if known is not None and self.now_ns() - known.at_ns < CLOCK_AGE_S * NS:
            return known
        asked_ns = self.now_ns()
        answer = await self.request(robot, mesh_json.Sync())
        answered_ns = self.now_ns()
        if isinstance(answer, Refused):
            return answer
        robot_ns = int(answer["robot_ns"])
        reading = Reading(str(answer["clock"]), robot_ns - answered_ns, robot_ns - asked_ns, answered_ns)
        self._clocks[robot] = reading
        return reading

    def forget_clock(self, robot: str) -> None:
        """It is read again before the next use: the robot says that it does not know the last
        reading."""
        self._clocks.pop(robot, None)

    async def _ask(self, robot: str, key: str, body: dict[str, Any], within_s: float) -> dict[str, Any] | Refused:
        via = await self.sessions.until_there(robot)
        if via is None:
            names = ", ".join(self.sessions.via) or "none"
            return Refused(Code.UNREACHABLE, f"{robot} is not on the mesh", f"these are: {names}")
        with self._turn() as (turn, answers):
            self._send(via, key, robot, turn, body)
            with trio.move_on_after(within_s) as patience:
                async for response in answers:
                    if response.final:
                        return result_of(response)
                    # It is known that the robot heard; how long it may take is its driver's to say.
                    longer_s = float((response.result or {}).get("within_s", 0.0))
                    patience.deadline = max(patience.deadline, trio.current_time() + longer_s)
        return Refused(
            Code.NO_ANSWER,
            busy.explained(f"{robot} gave no answer within {within_s:g} s"),
            "is it frozen, or denied to you?",
        )

    def _send(self, via: PubSub, key: str, robot: str, turn: str, body: dict[str, Any]) -> None:
        """A command for one robot is a question: what it says and what it is answered, leases among
        it, are heard by nobody else."""
        if key != mesh_json.key(robot, "cmd"):
            via.put(key, self._enveloped(robot, turn, body), _COMMAND)
            return
        envelope = self._enveloped(robot, turn, {"proof": self._proof, **body})
        asked = mesh_json.command_key(robot, self.sender)
        via.ask(asked, envelope, _COMMAND, lambda received: self._on_answer(via, robot, received))

    def _enveloped(self, robot: str, turn: str, body: dict[str, Any]) -> bytes:
        envelope = {"sender_id": self.sender, "turn_id": turn, "target_id": robot, "timestamp": time.time(), **body}
        return encode(envelope)

    def _new_turn(self) -> str:
        return f"{next(self._turns)}"

    @contextlib.contextmanager
    def _turn(self) -> Iterator[tuple[str, trio.MemoryReceiveChannel[Response]]]:
        turn, answers = self._open_turn()
        try:
            yield turn, answers
        finally:
            del self._waiting[turn]

    def _open_turn(self) -> tuple[str, trio.MemoryReceiveChannel[Response]]:
        send, receive = trio.open_memory_channel[Response](256)
        turn = self._new_turn()
        self._waiting[turn] = send
        return turn, receive

    def _on_response(self, session: PubSub, received: Received) -> None:
        self._on_answer(session, received.key.split("/")[3], received)

    def _on_answer(self, session: PubSub, robot: str, received: Received) -> None:
        try:
            response = _decode_response(received.payload)
        except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError):
            return  # nobody waits for what cannot be read
        waiting = self._waiting.get(response.turn_id)
        if waiting is None or response.responder_id != robot:
            return
        if self.sessions.speaks_for(session, response.responder_id):
            with contextlib.suppress(trio.WouldBlock):
                waiting.send_nowait(response)

    # -- e-stop

    async def estop(self, by: str = "", within_s: float = ESTOP_ANSWER_S, robot: str = "*") -> list[Outcome]:
        """Every robot on the mesh, or only ``robot``, goes safe and is locked until it is resumed.
        A report on each that is known, within ``within_s`` (0.25 s at least: as long as it may take
        until all have heard); one that does not answer is unreachable, and counts as moving. No
        report at all: there is nobody. Neither a wrong ``within_s`` nor a wrong ``by`` keeps the
        order from leaving."""
        pressed = self.press(by, robot)
        try:
            await trio.sleep(AWAY_S)
            return await self.outcomes(pressed, within_s)
        finally:
            self._waiting.pop(pressed.turn, None)  # cancelled before it was waited for

    def press(self, by: str = "", robot: str = "*") -> Pressed:
        """Send the order of an ``estop``, from any thread: it leaves in this call, whatever the
        loop does. After ``AWAY_S`` its ``outcomes`` are to be waited for."""
        by = signed(by)
        turn, answers = self._open_turn()
        return Pressed(turn, by, robot, answers, *self._order_estop(turn, by, robot))

    def _order_estop(self, turn: str, by: str, robot: str) -> tuple[trio.Event, list[PubSub]]:
        """To everybody who is known now: who they are, and what tells that somebody has appeared
        since."""
        appeared, sessions = self.sessions.appeared, self.sessions.all
        order = self._enveloped(robot, turn, {"by": by})
        for session in sessions:
            with contextlib.suppress(zenoh.ZError):  # left by the loop meanwhile: its robot is gone
                session.put(mesh_json.ESTOP_KEY, order, _COMMAND)
        return appeared, sessions

    async def outcomes(self, pressed: Pressed, within_s: float = ESTOP_ANSWER_S) -> list[Outcome]:
        """Return what became of the robots that were meant, as of ``estop``: ``within_s`` of when it
        was pressed."""
        found: dict[str, Outcome] = {}
        turn, by, robot, answers, appeared, sessions = pressed
        settled_at = self.sessions.opened_at + LOOK_S
        try:
            with trio.move_on_after(patience_s(within_s) - AWAY_S):
                while True:
                    await self.sessions.look()
                    if self.sessions.all == sessions:
                        await self._collect(found, answers, appeared, settled_at, robot)
                        if not appeared.is_set():
                            break
                    # Again to everybody whenever a robot appears: one order too many does no harm.
                    appeared, sessions = self._order_estop(turn, by, robot)
        finally:
            self._waiting.pop(turn, None)
        for stray in strays():
            if robot in ("*", stray.robot):
                found.setdefault(stray.robot, Outcome(stray.robot, "unreachable", stray.text))
        for missing in self._meant(robot):
            why = self.sessions.problems.get(missing, "")
            detail = busy.explained(f"it did not answer. {why}" if why else "it did not answer")
            found.setdefault(missing, Outcome(missing, "unreachable", detail))
        not_connected = (Outcome(end, "unreachable", why) for end, why in self.sessions.not_connected())
        return [*(found[name] for name in sorted(found)), *self.not_looked_for(), *not_connected]

    def not_looked_for(self) -> list[Outcome]:
        """Return of whom it could not even be asked whether they are there, and why."""
        told = {EVERYBODY: self.sessions.problems.get(EVERYBODY), OTHERS: self.unusable, **self.sessions.unjoined}
        return [Outcome(who, "unreachable", why) for who, why in told.items() if why]

    def _meant(self, robot: str) -> set[str]:
        return {name for name in self.robots if robot in ("*", name)}

    async def _collect(
        self,
        found: dict[str, Outcome],
        answers: trio.MemoryReceiveChannel[Response],
        appeared: trio.Event,
        settled_at: float,
        robot: str,
    ) -> None:
        """Return when all have answered and nobody else can be expected, or somebody has
        appeared."""
        remote = self._reaches_hosts
        done = {robot for robot, outcome in found.items() if outcome.outcome == "safe"}
        async with trio.open_nursery() as nursery:

            async def watch() -> None:
                await appeared.wait()
                nursery.cancel_scope.cancel()

            nursery.start_soon(watch)
            while not (done >= self._meant(robot) and (not remote or trio.current_time() >= settled_at)):
                response = await answers.receive()
                outcome = outcome_of(response.responder_id, response.result or {"detail": response.error})
                known = found.get(outcome.robot)
                if known is None or known.outcome != "safe":
                    found[outcome.robot] = outcome
                if response.final:
                    done.add(outcome.robot)
            nursery.cancel_scope.cancel()


@contextlib.asynccontextmanager
async def open_mesh(
    config: MeshConfig | str | os.PathLike[str] | None = None,
    now_ns: Callable[[], int] = time.monotonic_ns,
    to_stop: bool = False,
) -> AsyncIterator[MeshClient]:
    """Join the mesh for as long as the block runs. ``config``: or the path of its file; None: the
    environment's. Raise ``ValueError`` for one that cannot be used. ``to_stop``: that one keeps
    nobody from the robots of this user; it is told among the outcomes."""
    unusable = ""
    try:
        config = MeshConfig.of(config)
    except Exception as error:  # whatever it is: a slip in a file must not keep a robot moving
        if not to_stop:
            raise
        config, unusable = MeshConfig(), f"they were not looked for: {error}"
    async with open_background() as nursery:
        client = MeshClient(config, nursery, now_ns)
        client.unusable = unusable
        try:
            await client.sessions.join_configured(go_on=to_stop)
            await client.sessions.look()
            nursery.start_soon(client.sessions.keep_looking)
            yield client
        finally:
            with trio.CancelScope(shield=True):
                await client.sessions.close()
