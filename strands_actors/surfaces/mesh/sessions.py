"""The zenoh sessions (connections) of a client of the mesh.

There is one session for each robot of this user, and one for each endpoint in the configuration. So a
frozen robot does not block the others.

Messages of a robot are accepted only from the robot's own session. On a local socket, this is the session of
the robot that owns the socket. With TLS, it is the session of the robot that the certificate names. The client
connects to a robot that starts later within ``LOOK_S``.
"""

from __future__ import annotations

from collections.abc import Callable

import trio
import zenoh

from strands_actors.caller.processes.run_directory import notes
from strands_actors.contract.shown import shown
from strands_actors.kernel.actor import describe
from strands_actors.kernel.channels.pubsub import PubSub, Received
from strands_actors.kernel.channels.zenoh_session import short
from strands_actors.supervisors.mesh import schemas as mesh_json

from .config import MeshConfig

LOOK_S = 0.5
"""Period of the search for robots that have started or ended, and how long one may take to appear."""
EVERYBODY = "the robots of this user"
"""Stands for the name of a robot in an outcome when this user's robots cannot be listed."""
OTHERS = "the robots of other hosts"
"""As ``EVERYBODY``, when the configuration for other hosts cannot be used."""
MOST_TOKENS = 16384
"""Most robots that may appear at the same moment, for example behind a router."""
_NO_ROBOTS = ("safety", "broadcast", "node")
"""Parts of a key that stand in the place of a robot's name."""


class Sessions:
    """The sessions of one client.

    Args:
        config: The configuration.
        nursery: The trio nursery in which the sessions run.
        on_join: Called with each new session before its samples are handled.
    """

    def __init__(self, config: MeshConfig, nursery: trio.Nursery, on_join: Callable[[PubSub], None]) -> None:
        self._config = config
        self._nursery = nursery
        self._on_join = on_join
        self._open: dict[str, PubSub] = {}
        """By endpoint: a socket of this user, or one that the configuration names."""
        self._of_note: dict[PubSub, str] = {}
        """The robot that owns the socket of each session of this user."""
        self._impostors: dict[str, str] = {}
        """By endpoint: why the robot that announces itself there is not accepted."""
        self._subscriptions: list[tuple[str, Callable[[Received], None]]] = []
        self.via: dict[str, PubSub] = {}
        """The session of each robot on the mesh."""
        self._expected: set[str] = set()
        self.problems: dict[str, str] = {}
        """The reason why a robot, or ``EVERYBODY``, could not be looked for."""
        self.unjoined: dict[str, str] = {}
        """The reason why an endpoint of the configuration could not be joined."""
        self._looking = trio.Lock()
        self.appeared = trio.Event()
        """Set when the next robot appears. A new event then replaces it."""
        self.opened_at = trio.current_time()

    @property
    def all(self) -> list[PubSub]:
        return list(self._open.values())

    @property
    def robots(self) -> list[str]:
        """Return the names of the robots on the mesh, and of this user's running robots that have not appeared
        on it yet."""
        return sorted({*self.via, *self._expected})

    async def settle(self, within_s: float = LOOK_S) -> None:
        """Wait until all running robots of this user have appeared. If the configuration has endpoints,
        always wait ``within_s``, since it is not known which robots are there."""
        with trio.move_on_at(self.opened_at + within_s):
            while self._config.connects or not self._expected <= set(self.via):
                await self.appeared.wait()

    async def until_there(self, robot: str) -> PubSub | None:
        """Wait up to ``LOOK_S`` for a robot and return its session, or None if the robot has not appeared."""
        with trio.move_on_after(LOOK_S):
            while robot not in self.via:
                await self.appeared.wait()
        return self.via.get(robot)

    def subscribe(self, key: str, handler: Callable[[Received], None]) -> None:
        """Call ``handler`` for each message that is published on ``key``, also by robots that appear later."""
        self._subscriptions.append((key, handler))
        for session in self._open.values():
            self._subscribe(session, key, handler)

    def unsubscribe(self, key: str) -> None:
        """End all subscriptions of a key."""
        self._subscriptions = [each for each in self._subscriptions if each[0] != key]
        for session in self._open.values():
            session.unsubscribe(key)

    def _subscribe(self, session: PubSub, key: str, handler: Callable[[Received], None]) -> None:
        def handle(received: Received) -> None:
            parts = received.key.split("/")
            robot = parts[3] if parts[2:3] == ["response"] and len(parts) > 3 else parts[1]
            if robot in _NO_ROBOTS or self.speaks_for(session, robot):
                handler(received)

        session.subscribe(key, handle)

    # -- connect to robots, and disconnect

    async def look(self) -> None:
        """Connect to this user's robots that have started, and disconnect from robots that have ended.

        An error with one robot does not block the others. It is kept in ``problems``, and the outcomes of an
        e-stop report it.
        """
        async with self._looking:
            problems: dict[str, str] = {}
            try:
                await self._look(problems)
            except Exception as error:  # An e-stop must still reach the robots that are connected already.
                problems[EVERYBODY] = f"the list of running robots cannot be read: {describe(error)}"
            self.problems = problems

    async def _look(self, problems: dict[str, str]) -> None:
        noted = {note.mesh[0]: note for note in notes() if note.mesh}
        self._expected = {note.robot for note in noted.values()}
        for endpoint, session in list(self._open.items()):
            # A robot's note file may have been deleted while the robot runs. So check the connection, too.
            if session in self._of_note and endpoint not in noted and not session.connections:
                self._leave(self._open.pop(endpoint))
        for endpoint, note in noted.items():
            if note.problem:
                problems[note.robot] = note.problem
            if endpoint not in self._open:
                # This takes 1 ms and must not be cancelled. A session that is opened only halfway receives
                # nothing.
                with trio.CancelScope(shield=True):
                    try:
                        session = await PubSub.open(connect=[endpoint])
                    # A connection fails, for example, if file descriptors or threads have run out.
                    except (zenoh.ZError, OSError, RuntimeError) as error:
                        problems[note.robot] = f"no connection to the robot: {error}"
                    else:
                        self._of_note[session] = note.robot
                        await self._join(endpoint, session)

    async def join_configured(self, go_on: bool = False) -> None:
        """Connect to the endpoints of the configuration.

        Args:
            go_on: After a failure, connect to the other endpoints. ``unjoined`` keeps the reason of the
                failure.

        Raises:
            ValueError: A connection failed, for example because of a certificate, and ``go_on`` is False.
        """
        for endpoint in dict.fromkeys(self._config.connects):
            try:
                session = await PubSub.open(connect=[endpoint], settings=self._config.settings())
            # A connection fails, for example, if a certificate is missing, or file descriptors have run out.
            except (zenoh.ZError, OSError, RuntimeError) as error:
                reason = f"mesh: {endpoint}: {short(error) if isinstance(error, zenoh.ZError) else error}"
                if not go_on:
                    raise ValueError(reason) from error
                self.unjoined[endpoint] = reason
            else:
                await self._join(endpoint, session)

    async def _join(self, endpoint: str, session: PubSub) -> None:
        self._open[endpoint] = session
        self._on_join(session)
        tokens = mesh_json.key("*", "alive")
        session.watch_tokens(tokens, lambda token: self._on_token(endpoint, session, token), MOST_TOKENS)
        for key, handler in self._subscriptions:
            self._subscribe(session, key, handler)
        await self._nursery.start(session.run)

    def speaks_for(self, session: PubSub, robot: str) -> bool:
        """Return True if this session may carry messages of this robot."""
        if session in self._of_note:
            return self._of_note[session] == robot
        if self._config.tls is not None:
            return session.names == {robot}
        # Without TLS, no certificate proves a name. So the session that first used a name owns it.
        return self.via.get(robot, session) is session

    def _leave(self, session: PubSub) -> None:
        for robot in [robot for robot, via in self.via.items() if via is session]:
            del self.via[robot]
        self._of_note.pop(session, None)
        self._nursery.start_soon(trio.to_thread.run_sync, session.close)

    async def keep_looking(self) -> None:
        """Look for robots every ``LOOK_S``, until cancelled."""
        while True:
            await trio.sleep(LOOK_S)
            await self.look()

    async def close(self) -> None:
        for session in self._open.values():
            await trio.to_thread.run_sync(session.close)
        self._open.clear()

    def _on_token(self, endpoint: str, session: PubSub, token: Received) -> None:
        robot = token.key.split("/")[1]
        if not token.alive:
            if self.via.get(robot) is session:
                del self.via[robot]
            return
        if not mesh_json.is_name(robot):
            self._impostors[endpoint] = (
                f"the program at this endpoint uses {shown(robot)} as a robot's name, which is not valid"
            )
            return
        if not self.speaks_for(session, robot):
            owner = " and ".join(sorted(name for name in session.names if name)) or "another robot"
            self._impostors[endpoint] = f"the program at this endpoint claims to be {robot}, but it is {owner}"
            return
        self._impostors.pop(endpoint, None)
        self.via[robot] = session
        appeared, self.appeared = self.appeared, trio.Event()
        appeared.set()

    def not_connected(self) -> list[tuple[str, str]]:
        """Return the endpoints of the configuration at which no robot was found, each with the reason."""
        rows = []
        for endpoint in dict.fromkeys(self._config.connects):
            if endpoint in self.unjoined:
                continue  # ``MeshClient.not_looked_for`` reports these endpoints.
            session = self._open[endpoint]
            if (reason := self._impostors.get(endpoint)) is not None:
                rows.append((endpoint, reason))
            elif not session.connections:
                rows.append((endpoint, "there is no connection to this endpoint"))
            elif not any(via is session for via in self.via.values()):
                rows.append((endpoint, "the endpoint is connected, but no robot answers there"))
        return rows
