"""A client of the mesh, which watches, commands and stops robots. It runs on trio.

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

from strands_actors.caller.processes.background import open_background
from strands_actors.caller.processes.strays import strays
from strands_actors.kernel.channels.pubsub import PubSub, Received
from strands_actors.kernel.clock import NS
from strands_actors.kernel.health import busy
from strands_actors.kernel.messages import Refused
from strands_actors.kernel.refusals import Code
from strands_actors.supervisors.mesh import schemas as mesh_json
from strands_actors.supervisors.mesh.schemas import ESTOP_ANSWER_S, Command, Response, encode, schema

from . import refusals
from .config import MeshConfig
from .outcome import Outcome, outcome_of, result_of
from .sessions import EVERYBODY, LOOK_S, OTHERS, Sessions
from .signing import patience_s, signed

AWAY_S = 0.004
"""Time for an e-stop to reach the wires of this host. Work on the outcomes before that takes processor
time from the stop: a quarter of 2.8 ms, on two processors."""
ANSWER_S = 0.5
STOP_S = 3.0
"""How long to wait for the result of a stop. An interim answer of the robot can extend it."""
BEGIN_S = 2.0
"""A policy or a pose that has not begun within this time never begins."""
PRESENCE_S = 1.5
"""How long to wait for presence messages. A robot sends two a second, so two may be lost."""
CLOCK_AGE_S = 10.0
"""A clock is read again if the last reading is older."""

MOST_ANSWERS = 16384
"""Most answers that wait to be read. All robots behind a router answer an e-stop at the same moment."""

_decode_response = msgspec.json.Decoder(Response).decode
_COMMAND = schema("command")


class Reading(msgspec.Struct, frozen=True):
    """A reading of a robot's clock, with bounds of its offset from this host's clock.

    Attributes:
        name: The name that the robot has given to this reading. Commands with a deadline repeat it.
        lowest_ns: Lower bound of the robot's clock minus this host's clock, in nanoseconds.
        highest_ns: Upper bound of the robot's clock minus this host's clock, in nanoseconds.
        at_ns: The time of the reading on this host's clock, in nanoseconds.
    """

    name: str
    lowest_ns: int
    highest_ns: int
    at_ns: int

    def deadline(self, at_ns: int) -> int:
        """Convert a deadline from this host's clock to the robot's clock. The result may be too early, never
        too late."""
        return at_ns + self.lowest_ns


class Pressed(NamedTuple):
    """An e-stop that was sent, and the state that is needed to collect its answers."""

    turn: str
    by: str
    robot: str  # Name of the robot to stop, or "*" for every robot.
    answers: trio.MemoryReceiveChannel[Response]
    appeared: trio.Event  # Set when another robot appears.
    sessions: list[PubSub]  # The sessions over which the stop was sent.


class MeshClient:
    """A client of the mesh, made by ``open_mesh``.

    Args:
        config: The configuration.
        nursery: The trio nursery in which the sessions run.
        now_ns: This host's clock, in nanoseconds. Tests pass another one.
    """

    def __init__(
        self, config: MeshConfig, nursery: trio.Nursery, now_ns: Callable[[], int] = time.monotonic_ns
    ) -> None:
        self.sender = f"{config.own_prefix or _user() + '-'}{os.getpid()}-{secrets.token_hex(3)}"
        self._proof = secrets.token_hex(16)
        self.now_ns = now_ns
        self.sessions = Sessions(config, nursery, self._on_join)
        self._reaches_hosts = bool(config.connects)
        self._turns = itertools.count(1)
        self._waiting: dict[str, trio.MemorySendChannel[Response]] = {}
        self._clocks: dict[str, Reading] = {}
        self.unusable = ""
        """Why the configuration could not be used; empty if it is in use."""

    def _on_join(self, session: PubSub) -> None:
        session.get_ready(mesh_json.ESTOP_KEY, _COMMAND)
        responses = mesh_json.response_key(self.sender, "*", "*")
        session.subscribe(responses, lambda received: self._on_response(session, received), keep=MOST_ANSWERS)

    # -- robots

    @property
    def robots(self) -> list[str]:
        """Return the names of the robots on the mesh, and of this user's running robots that have not appeared
        on it yet."""
        return self.sessions.robots

    async def settle(self, within_s: float = LOOK_S) -> None:
        """Wait until all running robots of this user have appeared. Robots on other hosts get ``within_s`` to
        appear."""
        await self.sessions.settle(within_s)

    def is_there(self, robot: str) -> bool:
        return robot in self.sessions.via

    def subscribe(self, key: str, handler: Callable[[Received], None]) -> None:
        """Call ``handler`` for each message that is published on ``key``, also by robots that appear later."""
        self.sessions.subscribe(key, handler)

    def unsubscribe(self, key: str) -> None:
        """End all subscriptions of a key."""
        self.sessions.unsubscribe(key)

    # -- requests

    async def request(
        self, robot: str, command: Command | dict[str, Any], within_s: float = ANSWER_S
    ) -> dict[str, Any] | Refused:
        """Send one command and return its result."""
        return await self._ask(robot, mesh_json.key(robot, "cmd"), {"command": command}, within_s)

    async def stop(self, robot: str, by: str = "", within_s: float = STOP_S) -> Outcome:
        """Stop one robot. The stop has a separate key, because the robot's command key may be flooded."""
        body = {"command": mesh_json.Stop(by=signed(by))}
        answer = await self._ask(robot, mesh_json.BROADCAST_KEY, body, within_s)
        if isinstance(answer, Refused):
            return Outcome(robot, "unreachable", answer.text)
        return outcome_of(robot, answer)

    async def resume(self, robot: str, by: str = "", within_s: float = 12.0) -> dict[str, Any] | Refused:
        """Lift a lockout and energise the robot at the measured position. This starts no motion."""
        clock = await self.clock(robot)
        if isinstance(clock, Refused):
            return clock
        deadline_ns = clock.deadline(self.now_ns() + round(ANSWER_S * NS))
        return await self.request(
            robot, mesh_json.Resume(clock=clock.name, deadline_ns=deadline_ns, by=signed(by)), within_s
        )

    async def post(self, robot: str, command: Command) -> None:
        """Send one command, and do not wait for an answer."""
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
        """Send a command with a deadline and return its result.

        Args:
            robot: The robot.
            make: Returns the command. It gets the identifier of a reading of the robot's clock, and the deadline
                on this clock.
            ttl_s: Seconds from now to the deadline. The robot does not carry out the command later.
            within_s: How long to wait for the result.
        """
        answer: dict[str, Any] | Refused = refusals.clock_not_read()
        for _ in range(2):
            clock = await self.clock(robot)
            if isinstance(clock, Refused):
                return clock
            deadline_ns = clock.deadline(self.now_ns() + round(ttl_s * NS))
            answer = await self.request(robot, make(clock.name, deadline_ns), within_s)
            if not isinstance(answer, Refused) or answer.code != Code.CLOCK:
                break
            self.forget_clock(robot)  # The robot has restarted, so the old reading is no longer valid.
        return answer

    async def clock(self, robot: str) -> Reading | Refused:
        """Return a reading of the robot's clock.

        The robot reads its clock when it sends the answer. So a deadline is too early by at most the time that
        the answer takes to arrive.
        """
        last_reading = self._clocks.get(robot)
        if last_reading is not None and self.now_ns() - last_reading.at_ns < CLOCK_AGE_S * NS:
            return last_reading
        requested_ns = self.now_ns()
        answer = await self.request(robot, mesh_json.Sync())
        answered_ns = self.now_ns()
        if isinstance(answer, Refused):
            return answer
        robot_ns = int(answer["robot_ns"])
        reading = Reading(str(answer["clock"]), robot_ns - answered_ns, robot_ns - requested_ns, answered_ns)
        self._clocks[robot] = reading
        return reading

    def forget_clock(self, robot: str) -> None:
        """Drop the reading of a robot's clock, for example because the robot has restarted and no longer
        accepts it."""
        self._clocks.pop(robot, None)

    async def _ask(self, robot: str, key: str, body: dict[str, Any], within_s: float) -> dict[str, Any] | Refused:
        via = await self.sessions.until_there(robot)
        if via is None:
            names = ", ".join(self.sessions.via) or "none"
            return refusals.unknown_robot(robot, names)
        with self._turn() as (turn, answers):
            self._send(via, key, robot, turn, body)
            with trio.move_on_after(within_s) as patience:
                async for response in answers:
                    if response.final:
                        return result_of(response)
                    # An interim answer confirms that the robot has received the command. It states how long
                    # the robot may still need, which depends on the driver.
                    longer_s = float((response.result or {}).get("within_s", 0.0))
                    patience.deadline = max(patience.deadline, trio.current_time() + longer_s)
        return busy.with_load(refusals.no_answer(robot, within_s))

    def _send(self, via: PubSub, key: str, robot: str, turn: str, body: dict[str, Any]) -> None:
        """Send a message to robots. A command for one robot is sent as a query, so that only the robot gets the
        command and only this client gets the answer, which may contain a lease."""
        if key != mesh_json.key(robot, "cmd"):
            via.put(key, self._enveloped(robot, turn, body), _COMMAND)
            return
        envelope = self._enveloped(robot, turn, {"proof": self._proof, **body})
        query_key = mesh_json.command_key(robot, self.sender)
        via.ask(query_key, envelope, _COMMAND, lambda received: self._on_answer(via, robot, received))

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
        send, receive = trio.open_memory_channel[Response](MOST_ANSWERS)
        turn = self._new_turn()
        self._waiting[turn] = send
        return turn, receive

    def _on_response(self, session: PubSub, received: Received) -> None:
        self._on_answer(session, received.key.split("/")[3], received)

    def _on_answer(self, session: PubSub, robot: str, received: Received) -> None:
        try:
            response = _decode_response(received.payload)
        except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError):
            return  # An answer that cannot be decoded belongs to no query of this client.
        waiting = self._waiting.get(response.turn_id)
        if waiting is None or response.responder_id != robot:
            return
        if self.sessions.speaks_for(session, response.responder_id):
            with contextlib.suppress(trio.WouldBlock):
                waiting.send_nowait(response)

    # -- e-stop

    async def estop(self, by: str = "", within_s: float = ESTOP_ANSWER_S, robot: str = "*") -> list[Outcome]:
        """Stop every robot on the mesh, or only ``robot``, and lock it until it is resumed. The stop is sent
        even if ``within_s`` or ``by`` is wrong.

        Args:
            by: The name that the robots report as the origin of the stop. Default: this program.
            within_s: How long to wait for the results. At least 0.25 s, which all robots may need to
                receive the order.
            robot: A robot's name, or ``*`` for all.

        Returns:
            The result of each known robot; empty if there is no robot. A robot that does not answer is
            unreachable, and counts as moving.
        """
        pressed = self.press(by, robot)
        try:
            await trio.sleep(AWAY_S)
            return await self.outcomes(pressed, within_s)
        finally:
            # ``outcomes`` also removes this entry, but may never run if this task is cancelled.
            self._waiting.pop(pressed.turn, None)

    def press(self, by: str = "", robot: str = "*") -> Pressed:
        """Send an e-stop from any thread, even if the event loop is blocked. When this method returns, the e-stop
        has been sent. Then wait ``AWAY_S``, and call ``outcomes`` for the results."""
        by = signed(by)
        turn, answers = self._open_turn()
        return Pressed(turn, by, robot, answers, *self._order_estop(turn, by, robot))

    def _order_estop(self, turn: str, by: str, robot: str) -> tuple[trio.Event, list[PubSub]]:
        """Send the e-stop over all present sessions. Return an event that is set when another robot appears,
        and the list of the sessions."""
        appeared, sessions = self.sessions.appeared, self.sessions.all
        order = self._enveloped(robot, turn, {"by": by})
        for session in sessions:
            # The session of a robot that has ended may just have been closed.
            with contextlib.suppress(zenoh.ZError):
                session.put(mesh_json.ESTOP_KEY, order, _COMMAND)
        return appeared, sessions

    async def outcomes(self, pressed: Pressed, within_s: float = ESTOP_ANSWER_S) -> list[Outcome]:
        """Return the result of each robot for an e-stop that ``press`` has sent, at most ``within_s`` after
        ``press``."""
        outcomes: dict[str, Outcome] = {}
        turn, by, robot, answers, appeared, sessions = pressed
        settled_at = self.sessions.opened_at + LOOK_S
        try:
            with trio.move_on_after(patience_s(within_s) - AWAY_S):
                while True:
                    await self.sessions.look()
                    if self.sessions.all == sessions:
                        await self._collect(outcomes, answers, appeared, settled_at, robot)
                        if not appeared.is_set():
                            break
                    # When a robot appears, send the stop to all robots again. A second stop does no harm.
                    appeared, sessions = self._order_estop(turn, by, robot)
        finally:
            self._waiting.pop(turn, None)
        for stray in strays():
            if robot in ("*", stray.robot):
                outcomes.setdefault(stray.robot, Outcome(stray.robot, "unreachable", stray.text))
        for missing in self._addressed(robot):
            reason = self.sessions.problems.get(missing, "")
            detail = busy.explained(f"it did not answer. {reason}" if reason else "it did not answer")
            outcomes.setdefault(missing, Outcome(missing, "unreachable", detail))
        not_connected = (Outcome(end, "unreachable", reason) for end, reason in self.sessions.not_connected())
        return [*(outcomes[name] for name in sorted(outcomes)), *self.not_looked_for(), *not_connected]

    def not_looked_for(self) -> list[Outcome]:
        """Return an outcome for each group of robots for which the search failed, with the reason."""
        reasons = {
            EVERYBODY: self.sessions.problems.get(EVERYBODY),
            OTHERS: self.unusable,
            **self.sessions.unjoined,
        }
        return [Outcome(group, "unreachable", reason) for group, reason in reasons.items() if reason]

    def _addressed(self, robot: str) -> set[str]:
        return {name for name in self.robots if robot in ("*", name)}

    async def _collect(
        self,
        outcomes: dict[str, Outcome],
        answers: trio.MemoryReceiveChannel[Response],
        appeared: trio.Event,
        settled_at: float,
        robot: str,
    ) -> None:
        """Collect answers until every expected robot has answered, or until another robot appears."""
        remote = self._reaches_hosts
        done = {robot for robot, outcome in outcomes.items() if outcome.outcome == "safe"}
        async with trio.open_nursery() as nursery:

            async def watch() -> None:
                await appeared.wait()
                nursery.cancel_scope.cancel()

            nursery.start_soon(watch)
            while not (done >= self._addressed(robot) and (not remote or trio.current_time() >= settled_at)):
                response = await answers.receive()
                outcome = outcome_of(response.responder_id, response.result or {"detail": response.error})
                earlier = outcomes.get(outcome.robot)
                if earlier is None or earlier.outcome != "safe":
                    outcomes[outcome.robot] = outcome
                if response.final:
                    done.add(outcome.robot)
            nursery.cancel_scope.cancel()


def _user() -> str:
    """Return the name of the user, as a part of the sender's name. In a container the user may have no name."""
    try:
        name = getpass.getuser()
    except (KeyError, OSError):
        name = f"user-{os.getuid()}"
    return re.sub(r"[^A-Za-z0-9_-]", "-", name)[:32] or "user"


@contextlib.asynccontextmanager
async def open_mesh(
    config: MeshConfig | str | os.PathLike[str] | None = None,
    now_ns: Callable[[], int] = time.monotonic_ns,
    to_stop: bool = False,
) -> AsyncIterator[MeshClient]:
    """Join the mesh while the block runs.

    Args:
        config: The configuration, or the path of its file. Default: the file that
            ``STRANDS_ACTORS_MESH`` names.
        now_ns: This host's clock, in nanoseconds. Tests pass another one.
        to_stop: Connect to this user's robots even if the configuration cannot be used. The outcomes of an
            e-stop then report the error of the configuration.

    Raises:
        ValueError: The configuration cannot be used, and ``to_stop`` is False.
    """
    unusable = ""
    try:
        config = MeshConfig.of(config)
    except Exception as error:  # An error in the configuration must not prevent a stop.
        if not to_stop:
            raise
        config, unusable = MeshConfig(), f"no search was made, because the configuration is wrong: {error}"
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
