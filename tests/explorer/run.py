"""One run of the explorer: a tree, its callers, the events of the plan, and the end of the run."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable
from typing import Any

import msgspec

from strands_actors.kernel.health.heartbeat import new_page, private_page
from strands_actors.supervisors.loading import describe_driver
from strands_actors.supervisors.root import process as root
from strands_actors.supervisors.root import tasks
from strands_actors.supervisors.root.standby_keeper import ENTRY
from strands_actors.supervisors.standby import process as standby
from strands_actors.supervisors.wire import group

from .askers import ROBOT, Asker, Sweep
from .attack import attack
from .children import FORKED_S, SimAhead, SimChild, SimSpawner, Starter
from .evidence import Evidence
from .invariants import Violation, violations_of
from .kinds import AT_A_POINT, CALLER, EXHAUSTION, OPERATORS
from .links import Net, Socket
from .locks import SimLocks
from .plan import ACTIVE_S, BOOT_S, Event, Plan
from .robot_model import Effect, nothing, put
from .robots import MODELS
from .script import Script, SimProcesses
from .seams import seams
from .world import World

LAST_S = BOOT_S + ACTIVE_S + 0.2
"""When all faults are ended, and the caller is killed if it still runs."""


class Run:
    """One run. Call ``go`` once, and keep the object: none of its parts may be garbage-collected (see
    ``search``)."""

    def __init__(self, plan: Plan) -> None:
        self.plan = plan
        self.world = world = World(plan.seed)
        self.violations: tuple[Violation, ...] = ()
        self.net = Net(world)
        self.model = MODELS[plan.robot](world, plan.robot)
        self.actions = Sweep.actions = self.model.actions()
        SimProcesses.start_root = self._start_root
        SimLocks.disk = {}
        self.starter = Starter(
            world,
            {
                "strands_actors.supervisors.root.process:main": ("root", self._root),
                "strands_actors.supervisors.wire.group:main": ("wire", group._main),  # type: ignore[dict-item]
                ENTRY: ("standby", standby._main),  # type: ignore[dict-item]
                "strands_actors.supervisors.root.tasks:main": ("policy", tasks._main),  # type: ignore[dict-item]
            },
        )
        for name in (CALLER, *OPERATORS):
            events = self._asks(name)
            if name == CALLER or events:
                self._start_asker(name, events)
        for event in plan.events:
            if event.kind in _DONE_TO or not event.who:
                world.at(world.began_s + event.at_s, lambda event=event: self._befall(event))  # type: ignore[misc]

    def go(self) -> None:
        world = self.world
        with seams(world, self.net, self.starter, self.model):
            world.run(world.began_s + LAST_S)
            self._mend()
            world.run(world.began_s + LAST_S + self.model.SETTLE_S)
            world.close()
        seen = Evidence(world, self.model, world.began_s + LAST_S)
        self.violations = violations_of(seen)

    def digest(self) -> str:
        """Return a hash of the whole history."""
        return hashlib.blake2b(msgspec.msgpack.encode(self.world.rows), digest_size=16).hexdigest()

    # -- the tree

    def _start_asker(self, name: str, events: list[Event]) -> None:
        rest = self.world, name, events, self.actions, self.model.driver
        asker = Script(*rest, self.plan.style, self.model) if name == CALLER else Asker(*rest)
        self.world.start(name, asker.main, None)

    def _asks(self, name: str, from_s: float = 0.0) -> list[Event]:
        return [
            event
            for event in self.plan.events
            if event.who == name and event.kind not in _DONE_TO and event.at_s >= from_s
        ]

    def _restart(self) -> None:
        """Kill the script. Start it again after half a second, or when its tree has ended if that takes
        longer."""
        caller = self.world.find(CALLER)
        self.world.restarts += 1
        if caller is not None:
            caller.kill()
        self.world.after(0.5, self._start_again)

    def _start_again(self) -> None:
        if not self.world.restarts:
            return  # The run ends.
        if self.world.find("root") or self.world.find("standby"):  # They still have its name and port.
            self.world.after(0.1, self._start_again)
            return
        self.world.restarts -= 1
        now_s = self.world.now_s - self.world.began_s
        self._start_asker(CALLER, self._asks(CALLER, now_s))

    def _start_root(self, caller: str) -> tuple[SimChild, memoryview]:
        """Start the root. Return its process, and the page that the tree's processes share."""
        world, model = self.world, self.model
        page = new_page()
        words = world.pages[os.fstat(page).st_ino] = private_page()
        world.descriptors.append(page)
        args = {
            "robot": ROBOT,
            "driver": describe_driver(
                model.driver_class, model.robot, model.PORT, model.driver_class.resolve(model.robot, model.OPTIONS)
            ),
            "caller_pid": world.current.pid,
            "caller": caller,
            "note": "",
            "twin_pid": 0,
            "locks": "",
            "audit": "",
            "lock_port": model.PORT,
            "listen": "root",
            "wire_listen": "wire",
            "policy_listen": "policy",
            "connect": ["caller"],
            "secret": "",
            "page": page,
            "label": "",
            "standby": {"lock": "", "place": model.PORT, "report": ""},
            "mesh": {"listen": [], "connect": [], "settings": {}},
        }
        return self.starter.start("strands_actors.supervisors.root.process:main", args, FORKED_S), words

    async def _root(self, args: dict[str, Any], sock: Socket) -> None:
        starter = self.starter
        ahead = root.Ahead(SimSpawner(starter), SimAhead(starter), SimAhead(starter), args["page"])  # type: ignore[arg-type]
        await root._main(args, sock, ahead)  # type: ignore[arg-type]

    # -- the events of the plan

    def _befall(self, event: Event) -> None:
        """Begin an event now, or at the moment of its victim that the plan names."""
        begin, end = self._effect(event)
        victim = self.world.find(event.who)

        def befall() -> None:
            self.world.note("plan", event.kind, f"{event.who or event.motor} {event.value or ''}")
            self.world.befell.append((self.world.now_s, event))
            begin()
            if event.value and event.kind not in ("kill", *AT_A_POINT):
                self.world.after(event.value, lambda: self._over(event, end))

        if event.after and victim is not None:
            victim.at_moment(event.after, event.steps, befall)
        else:
            befall()

    def _over(self, event: Event, end: Callable[[], None]) -> None:
        self.world.note("plan", "ends", event.kind)
        end()

    def _effect(self, event: Event) -> Effect:
        """Return functions that begin and end an event."""
        victim = self.world.find(event.who)
        of_the_wire = self.model.effect(event)
        if of_the_wire is not None:
            return of_the_wire
        match event.kind:
            case "restart":
                return self._restart, nothing
            case "attack":
                return lambda: attack(self.net), nothing
            case "slow spawner":
                return put(self.starter, "spawner_slow_s", event.value, 0.0)
            case "slow mesh":
                return put(self.net, "slow_s", 0.3, 0.0)
            case "cut mesh":
                return lambda: self.net.cut.add(event.who), lambda: self.net.cut.discard(event.who)
        if victim is None:
            return nothing, nothing
        match event.kind:
            case "kill":
                return lambda: victim.kill(by_plan=True), nothing
            case "freeze":
                return victim.freeze, victim.go_on
            case "lag":
                return put(victim, "lag_s", event.value, 0.0)
            case kind if kind in EXHAUSTION:
                return lambda: victim.resources.lack(kind), lambda: setattr(victim.resources, "lacks", "")
        raise ValueError(f"{event.kind} is no event")

    def _mend(self) -> None:
        """End all faults, so that the tree is the cause of any problem after this."""
        self.world.note("plan", "everything is mended")
        self.world.restarts = 0
        self.model.mend()
        self.net.cut.clear()
        for process in self.world.processes:
            process.lag_s = 0.0
            process.resources.lacks = ""
            process.go_on()
        while (caller := self.world.find(CALLER)) is not None:
            caller.kill()


_DONE_TO = frozenset(
    {"kill", "freeze", "lag", "cut mesh", "slow mesh", "slow spawner", "restart", "attack", *EXHAUSTION}
)
"""Kinds of events in which ``who`` is the victim."""
