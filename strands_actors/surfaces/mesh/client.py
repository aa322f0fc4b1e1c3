"""Everybody else on the mesh: who watches, commands, stops. On trio.

    async with open_mesh() as mesh:
        for outcome in await mesh.estop():
            print(outcome.robot, outcome.outcome)

One session for each robot of this user, and for each endpoint that the configuration names: a robot
that is frozen keeps nobody from reaching the others, and what is said of a robot counts from its own
session alone. A session is of the robot whose socket it is, or whose certificate. Robots that start
later are joined within ``LOOK_S``.
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
from strands_actors.caller.run_directory import notes
from strands_actors.caller.strays import strays
from strands_actors.contract.shown import shown
from strands_actors.kernel.actor import describe
from strands_actors.kernel.channels.pubsub import PubSub, Received
from strands_actors.kernel.channels.zenoh_session import short
from strands_actors.kernel.clock import NS
from strands_actors.kernel.messages import Refused
from strands_actors.supervisors.mesh import schemas as mesh_json
from strands_actors.supervisors.mesh.schemas import ESTOP_ANSWER_S, Command, Response, encode, schema

from .config import MeshConfig
from .outcome import Outcome, outcome_of, result_of

LOOK_S = 0.5
"""How often it is looked for robots that have come or gone, and how long one may take to appear."""
EVERYBODY = "the robots of this user"
"""Instead of a robot's name, when nobody can say who there is."""
AWAY_S = 0.004
"""For an e-stop to be on the wires of this host. Who waits for its outcomes before that takes a
processor from it: a quarter of 2.8 ms, on two."""
ANSWER_S = 0.5
_NO_ROBOTS = ("safety", "broadcast", "node")
"""What may stand in a key where a robot's name does."""
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
        """A time of ours in the robot's, never later than meant."""
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
        self.now_ns = now_ns
        self._config = config
        self._nursery = nursery
        self._sessions: dict[str, PubSub] = {}
        """By endpoint: a socket of this user, or one that the configuration names."""
        self._of_note: dict[PubSub, str] = {}
        """Whose socket a session of this user is connected to."""
        self._impostors: dict[str, str] = {}
        """By endpoint: who there says to be a robot that it is not."""
        self._subscriptions: list[tuple[str, Callable[[Received], None]]] = []
        self._via: dict[str, PubSub] = {}
        self._expected: set[str] = set()
        self._problems: dict[str, str] = {}
        """By robot, or what else could not be looked at: why."""
        self._turns = itertools.count(1)
        self._waiting: dict[str, trio.MemorySendChannel[Response]] = {}
        self._clocks: dict[str, Reading] = {}
        self._looking = trio.Lock()
        self._appeared = trio.Event()
        self._opened_at = trio.current_time()

    # -- sessions

    async def look(self) -> None:
        """Join robots of this user that have come, leave those that are gone. What cannot be looked at keeps nobody
        from the others: it is told among the outcomes of an e-stop."""
        async with self._looking:
            problems: dict[str, str] = {}
            try:
                await self._look(problems)
            except Exception as error:  # whatever it is: who holds the button still reaches whom it knows
                problems[EVERYBODY] = f"they cannot be looked for: {describe(error)}"
            self._problems = problems

    async def _look(self, problems: dict[str, str]) -> None:
        found = {note.mesh[0]: note for note in notes() if note.mesh}
        self._expected = {note.robot for note in found.values()}
        for endpoint, session in list(self._sessions.items()):
            # A note may have been deleted while its robot runs.
            if session in self._of_note and endpoint not in found and not session.connections:
                self._leave(self._sessions.pop(endpoint))
        for endpoint, note in found.items():
            if note.problem:
                problems[note.robot] = note.problem
            if endpoint not in self._sessions:
                with trio.CancelScope(shield=True):  # a millisecond; half of it would be a deaf session
                    try:
                        session = await PubSub.open(connect=[endpoint])
                    except (zenoh.ZError, OSError, RuntimeError) as error:  # no descriptor, no thread
                        problems[note.robot] = f"it cannot be joined: {error}"
                    else:
                        self._of_note[session] = note.robot
                        await self._join(endpoint, session)

    async def join_configured(self) -> None:
        """Raise ``ValueError`` when a certificate cannot be used."""
        for endpoint in dict.fromkeys(self._config.connects):
            try:
                session = await PubSub.open(connect=[endpoint], settings=self._config.settings())
            except zenoh.ZError as error:
                raise ValueError(f"mesh: {endpoint}: {short(error)}") from error
            await self._join(endpoint, session)

    async def _join(self, endpoint: str, session: PubSub) -> None:
        self._sessions[endpoint] = session
        session.get_ready(mesh_json.ESTOP_KEY, _COMMAND)
        responses = mesh_json.response_key(self.sender, "*", "*")
        session.subscribe(responses, lambda received: self._on_response(session, received))
        tokens = mesh_json.key("*", "alive")
        session.watch_tokens(tokens, lambda token: self._on_token(endpoint, session, token))
        for key, handler in self._subscriptions:
            self._subscribe(session, key, handler)
        await self._nursery.start(session.run)

    def _speaks_for(self, session: PubSub, robot: str) -> bool:
        """Whether what comes over this session may be of that robot."""
        if session in self._of_note:
            return self._of_note[session] == robot
        if self._config.tls is not None:
            return session.names == {robot}
        return self._via.get(robot, session) is session  # nobody has a proof: who came first

    def _leave(self, session: PubSub) -> None:
        for robot in [robot for robot, via in self._via.items() if via is session]:
            del self._via[robot]
        self._of_note.pop(session, None)
        self._nursery.start_soon(trio.to_thread.run_sync, session.close)

    async def keep_looking(self) -> None:
        while True:
            await trio.sleep(LOOK_S)
            await self.look()

    async def close(self) -> None:
        for session in self._sessions.values():
            await trio.to_thread.run_sync(session.close)
        self._sessions.clear()

    def _on_token(self, endpoint: str, session: PubSub, token: Received) -> None:
        robot = token.key.split("/")[1]
        if not token.alive:
            if self._via.get(robot) is session:
                del self._via[robot]
            return
        if not mesh_json.is_name(robot):
            self._impostors[endpoint] = f"who is there says to be {shown(robot)}, which is no name"
            return
        if not self._speaks_for(session, robot):
            who = " and ".join(sorted(name for name in session.names if name)) or "another robot"
            self._impostors[endpoint] = f"who is there says to be {robot}, and is {who}"
            return
        self._impostors.pop(endpoint, None)
        self._via[robot] = session
        appeared, self._appeared = self._appeared, trio.Event()
        appeared.set()

    # -- reading

    @property
    def robots(self) -> list[str]:
        """Those that are on the mesh, and those of this user that should be."""
        return sorted({*self._via, *self._expected})

    async def settle(self, within_s: float = LOOK_S) -> None:
        """Return when every robot that is expected is there, and others have had the time to
        appear."""
        with trio.move_on_at(self._opened_at + within_s):
            while self._config.connects or not self._expected <= set(self._via):
                await self._appeared.wait()

    def is_there(self, robot: str) -> bool:
        return robot in self._via

    def subscribe(self, key: str, handler: Callable[[Received], None]) -> None:
        """Call ``handler`` for each sample, of robots that come later too."""
        self._subscriptions.append((key, handler))
        for session in self._sessions.values():
            self._subscribe(session, key, handler)

    def _subscribe(self, session: PubSub, key: str, handler: Callable[[Received], None]) -> None:
        def handle(received: Received) -> None:
            parts = received.key.split("/")
            robot = parts[3] if parts[2:3] == ["response"] and len(parts) > 3 else parts[1]
            if robot in _NO_ROBOTS or self._speaks_for(session, robot):
                handler(received)

        session.subscribe(key, handle)

    # -- asking

    async def request(
        self, robot: str, command: Command | dict[str, Any], within_s: float = ANSWER_S
    ) -> dict[str, Any] | Refused:
        """Send one command; its result."""
        return await self._ask(robot, mesh_json.key(robot, "cmd"), {"command": command}, within_s)

    async def stop(self, robot: str, by: str = "", within_s: float = STOP_S) -> Outcome:
        """Make one robot safe. Not by its command key: that may be flooded."""
        body = {"command": mesh_json.Stop(by=by)}
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
        body = {"by": by, "clock": clock.name, "deadline_ns": deadline_ns}
        return await self._ask(robot, mesh_json.RESUME_KEY, body, within_s)

    async def post(self, robot: str, command: Command) -> None:
        """Send one command that is not answered."""
        via = self._via.get(robot)
        if via is not None:
            self._put(via, mesh_json.key(robot, "cmd"), robot, self._new_turn(), {"command": command})

    async def dated(
        self,
        robot: str,
        make: Callable[[str, int], Command | dict[str, Any]],
        ttl_s: float,
        within_s: float = ANSWER_S,
    ) -> dict[str, Any] | Refused:
        """Send a command that must not be obeyed later than in ``ttl_s``; its result. ``make`` gets
        the name of the robot's clock, and the deadline in its time."""
        answer: dict[str, Any] | Refused = Refused("clock", "the robot's clock is not known")
        for _ in range(2):
            clock = await self.clock(robot)
            if isinstance(clock, Refused):
                return clock
            deadline_ns = clock.deadline(self.now_ns() + round(ttl_s * NS))
            answer = await self.request(robot, make(clock.name, deadline_ns), within_s)
            if not isinstance(answer, Refused) or answer.code != "clock":
                break
            self.forget_clock(robot)  # it was started anew
        return answer

    async def clock(self, robot: str) -> Reading | Refused:
        """The robot's clock. The answer leaves at once while the question may have waited, so it is
        the way back that bounds the error of ``deadline``."""
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
        via = await self._until_there(robot)
        if via is None:
            names = ", ".join(self._via) or "none"
            return Refused("unreachable", f"{robot} is not on the mesh", f"these are: {names}")
        with self._turn() as (turn, answers):
            self._put(via, key, robot, turn, body)
            with trio.move_on_after(within_s) as patience:
                async for response in answers:
                    if response.final:
                        return result_of(response)
                    # It is known that the robot heard; how long it may take is its driver's to say.
                    longer_s = float((response.result or {}).get("within_s", 0.0))
                    patience.deadline = max(patience.deadline, trio.current_time() + longer_s)
        return Refused(
            "no_answer", f"{robot} gave no answer within {within_s:g} s", "is it frozen, or denied to you?"
        )

    async def _until_there(self, robot: str) -> PubSub | None:
        with trio.move_on_after(LOOK_S):
            while robot not in self._via:
                await self._appeared.wait()
        return self._via.get(robot)

    def _put(self, via: PubSub, key: str, robot: str, turn: str, body: dict[str, Any]) -> None:
        via.put(key, self._enveloped(robot, turn, body), _COMMAND)

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
        try:
            response = _decode_response(received.payload)
        except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError):
            return  # nobody waits for what cannot be read
        waiting = self._waiting.get(response.turn_id)
        if waiting is None or response.responder_id != received.key.split("/")[3]:
            return
        if self._speaks_for(session, response.responder_id):
            with contextlib.suppress(trio.WouldBlock):
                waiting.send_nowait(response)

    # -- e-stop

    async def estop(self, by: str = "", within_s: float = ESTOP_ANSWER_S, robot: str = "*") -> list[Outcome]:
        """Every robot on the mesh, or only ``robot``, goes safe and is locked until it is resumed.
        A report on each that is known, within ``within_s``; one that does not answer is
        unreachable, and counts as moving. No report at all: there is nobody."""
        pressed = self.press(by, robot)
        try:
            await trio.sleep(AWAY_S)
            return await self.outcomes(pressed, within_s - AWAY_S)
        finally:
            self._waiting.pop(pressed.turn, None)  # cancelled before it was waited for

    def press(self, by: str = "", robot: str = "*") -> Pressed:
        """The order of an ``estop``, from any thread: it leaves in this call, whatever the loop
        does. After ``AWAY_S`` its ``outcomes`` are to be waited for."""
        turn, answers = self._open_turn()
        return Pressed(turn, by, robot, answers, *self._order_estop(turn, by, robot))

    def _order_estop(self, turn: str, by: str, robot: str) -> tuple[trio.Event, list[PubSub]]:
        """To everybody who is known now: who they are, and what tells that somebody has appeared
        since."""
        appeared, sessions = self._appeared, list(self._sessions.values())
        order = self._enveloped(robot, turn, {"by": by})
        for session in sessions:
            with contextlib.suppress(zenoh.ZError):  # left by the loop meanwhile: its robot is gone
                session.put(mesh_json.ESTOP_KEY, order, _COMMAND)
        return appeared, sessions

    async def outcomes(self, pressed: Pressed, within_s: float = ESTOP_ANSWER_S) -> list[Outcome]:
        """What became of the robots that were meant, as of ``estop``."""
        found: dict[str, Outcome] = {}
        turn, by, robot, answers, appeared, sessions = pressed
        settled_at = self._opened_at + LOOK_S
        try:
            with trio.move_on_after(within_s):
                while True:
                    await self.look()
                    if list(self._sessions.values()) == sessions:
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
            why = self._problems.get(missing, "")
            detail = f"it did not answer. {why}" if why else "it did not answer"
            found.setdefault(missing, Outcome(missing, "unreachable", detail))
        return [*(found[name] for name in sorted(found)), *self._not_looked_at(), *self._not_connected()]

    def _not_looked_at(self) -> list[Outcome]:
        why = self._problems.get(EVERYBODY)
        return [] if why is None else [Outcome(EVERYBODY, "unreachable", why)]

    def _meant(self, robot: str) -> set[str]:
        return {name for name in self.robots if robot in ("*", name)}

    def _not_connected(self) -> list[Outcome]:
        """Endpoints that the configuration names, and where no robot is that proves its name."""
        found = []
        for endpoint in dict.fromkeys(self._config.connects):
            session = self._sessions[endpoint]
            if (why := self._impostors.get(endpoint)) is not None:
                found.append(Outcome(endpoint, "unreachable", why))
            elif not session.connections:
                found.append(Outcome(endpoint, "unreachable", "it is not connected: who is there is not known"))
            elif not any(via is session for via in self._via.values()):
                found.append(Outcome(endpoint, "unreachable", "it is connected, and no robot answers there"))
        return found

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
        remote = bool(self._config.connects)
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
    config: MeshConfig | None = None, now_ns: Callable[[], int] = time.monotonic_ns
) -> AsyncIterator[MeshClient]:
    """Join the mesh for as long as the block runs. Raise ``ValueError`` for a configuration that
    cannot be used."""
    if config is None:
        config = MeshConfig.from_environment()
    config.check()
    async with open_background() as nursery:
        client = MeshClient(config, nursery, now_ns)
        try:
            await client.join_configured()
            await client.look()
            nursery.start_soon(client.keep_looking)
            yield client
        finally:
            with trio.CancelScope(shield=True):
                await client.close()
