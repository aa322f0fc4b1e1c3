"""The sessions of everybody else on the mesh: one for each robot of this user, and for each endpoint
that the configuration names. A robot that is frozen keeps nobody from reaching the others.

What is said of a robot counts from its own session alone: a session is of the robot whose socket it
is, or whose certificate. Robots that start later are joined within ``LOOK_S``.
"""

from __future__ import annotations

from collections.abc import Callable

import trio
import zenoh

from strands_actors.caller.run_directory import notes
from strands_actors.contract.shown import shown
from strands_actors.kernel.actor import describe
from strands_actors.kernel.channels.pubsub import PubSub, Received
from strands_actors.kernel.channels.zenoh_session import short
from strands_actors.supervisors.mesh import schemas as mesh_json

from .config import MeshConfig

LOOK_S = 0.5
"""How often it is looked for robots that have come or gone, and how long one may take to appear."""
EVERYBODY = "the robots of this user"
"""Instead of a robot's name, when nobody can say who there is."""
OTHERS = "the robots of other hosts"
"""The same, when the configuration that leads to them cannot be used."""
_NO_ROBOTS = ("safety", "broadcast", "node")
"""What may stand in a key where a robot's name does."""


class Sessions:
    """``on_join`` is called with each session before it is heard."""

    def __init__(self, config: MeshConfig, nursery: trio.Nursery, on_join: Callable[[PubSub], None]) -> None:
        self._config = config
        self._nursery = nursery
        self._on_join = on_join
        self._open: dict[str, PubSub] = {}
        """By endpoint: a socket of this user, or one that the configuration names."""
        self._of_note: dict[PubSub, str] = {}
        """Whose socket a session of this user is connected to."""
        self._impostors: dict[str, str] = {}
        """By endpoint: who there says to be a robot that it is not."""
        self._subscriptions: list[tuple[str, Callable[[Received], None]]] = []
        self.via: dict[str, PubSub] = {}
        """By robot that is on the mesh: its session."""
        self._expected: set[str] = set()
        self.problems: dict[str, str] = {}
        """By robot, or what else could not be looked at: why."""
        self.unjoined: dict[str, str] = {}
        """By endpoint of the configuration that could not be joined: why."""
        self._looking = trio.Lock()
        self.appeared = trio.Event()
        """Set when a robot appears next; another one from then on."""
        self.opened_at = trio.current_time()

    @property
    def all(self) -> list[PubSub]:
        return list(self._open.values())

    @property
    def robots(self) -> list[str]:
        """Return those that are on the mesh, and those of this user that should be."""
        return sorted({*self.via, *self._expected})

    async def settle(self, within_s: float = LOOK_S) -> None:
        """Return when every robot that is expected is there, and others have had the time to
        appear."""
        with trio.move_on_at(self.opened_at + within_s):
            while self._config.connects or not self._expected <= set(self.via):
                await self.appeared.wait()

    async def until_there(self, robot: str) -> PubSub | None:
        """Return its session, waiting ``LOOK_S`` for it to appear."""
        with trio.move_on_after(LOOK_S):
            while robot not in self.via:
                await self.appeared.wait()
        return self.via.get(robot)

    def subscribe(self, key: str, handler: Callable[[Received], None]) -> None:
        """Call ``handler`` for each sample, of robots that come later too."""
        self._subscriptions.append((key, handler))
        for session in self._open.values():
            self._subscribe(session, key, handler)

    def _subscribe(self, session: PubSub, key: str, handler: Callable[[Received], None]) -> None:
        def handle(received: Received) -> None:
            parts = received.key.split("/")
            robot = parts[3] if parts[2:3] == ["response"] and len(parts) > 3 else parts[1]
            if robot in _NO_ROBOTS or self.speaks_for(session, robot):
                handler(received)

        session.subscribe(key, handle)

    # -- joining and leaving

    async def look(self) -> None:
        """Join robots of this user that have come, leave those that are gone. What cannot be looked at keeps nobody
        from the others: it is told among the outcomes of an e-stop."""
        async with self._looking:
            problems: dict[str, str] = {}
            try:
                await self._look(problems)
            except Exception as error:  # whatever it is: who holds the button still reaches whom it knows
                problems[EVERYBODY] = f"they cannot be looked for: {describe(error)}"
            self.problems = problems

    async def _look(self, problems: dict[str, str]) -> None:
        found = {note.mesh[0]: note for note in notes() if note.mesh}
        self._expected = {note.robot for note in found.values()}
        for endpoint, session in list(self._open.items()):
            # A note may have been deleted while its robot runs.
            if session in self._of_note and endpoint not in found and not session.connections:
                self._leave(self._open.pop(endpoint))
        for endpoint, note in found.items():
            if note.problem:
                problems[note.robot] = note.problem
            if endpoint not in self._open:
                with trio.CancelScope(shield=True):  # a millisecond; half of it would be a deaf session
                    try:
                        session = await PubSub.open(connect=[endpoint])
                    except (zenoh.ZError, OSError, RuntimeError) as error:  # no descriptor, no thread
                        problems[note.robot] = f"it cannot be joined: {error}"
                    else:
                        self._of_note[session] = note.robot
                        await self._join(endpoint, session)

    async def join_configured(self, go_on: bool = False) -> None:
        """Raise ``ValueError`` when a certificate cannot be used. ``go_on``: keep that for the
        outcomes, and join the others."""
        for endpoint in dict.fromkeys(self._config.connects):
            try:
                session = await PubSub.open(connect=[endpoint], settings=self._config.settings())
            except (zenoh.ZError, OSError, RuntimeError) as error:  # no certificate, descriptor, thread
                why = f"mesh: {endpoint}: {short(error) if isinstance(error, zenoh.ZError) else error}"
                if not go_on:
                    raise ValueError(why) from error
                self.unjoined[endpoint] = why
            else:
                await self._join(endpoint, session)

    async def _join(self, endpoint: str, session: PubSub) -> None:
        self._open[endpoint] = session
        self._on_join(session)
        tokens = mesh_json.key("*", "alive")
        session.watch_tokens(tokens, lambda token: self._on_token(endpoint, session, token))
        for key, handler in self._subscriptions:
            self._subscribe(session, key, handler)
        await self._nursery.start(session.run)

    def speaks_for(self, session: PubSub, robot: str) -> bool:
        """Return whether what comes over this session may be of that robot."""
        if session in self._of_note:
            return self._of_note[session] == robot
        if self._config.tls is not None:
            return session.names == {robot}
        return self.via.get(robot, session) is session  # nobody has a proof: who came first

    def _leave(self, session: PubSub) -> None:
        for robot in [robot for robot, via in self.via.items() if via is session]:
            del self.via[robot]
        self._of_note.pop(session, None)
        self._nursery.start_soon(trio.to_thread.run_sync, session.close)

    async def keep_looking(self) -> None:
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
            self._impostors[endpoint] = f"who is there says to be {shown(robot)}, which is no name"
            return
        if not self.speaks_for(session, robot):
            who = " and ".join(sorted(name for name in session.names if name)) or "another robot"
            self._impostors[endpoint] = f"who is there says to be {robot}, and is {who}"
            return
        self._impostors.pop(endpoint, None)
        self.via[robot] = session
        appeared, self.appeared = self.appeared, trio.Event()
        appeared.set()

    def not_connected(self) -> list[tuple[str, str]]:
        """Endpoints that the configuration names, and where no robot is that proves its name; and why."""
        found = []
        for endpoint in dict.fromkeys(self._config.connects):
            if endpoint in self.unjoined:
                continue  # told beside them
            session = self._open[endpoint]
            if (why := self._impostors.get(endpoint)) is not None:
                found.append((endpoint, why))
            elif not session.connections:
                found.append((endpoint, "it is not connected: who is there is not known"))
            elif not any(via is session for via in self.via.values()):
                found.append((endpoint, "it is connected, and no robot answers there"))
        return found
