"""Feed what was recorded through the same gate and watchdog, in the time of then, and compare every
decision.

A step is one message that an actor took up, with all that it did: its answer, its tells (to the
transport, the guardian, the watchdog), the answers it settled. Bytes are compared, so that nothing
is equal but the same.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Coroutine
from typing import Any

import msgspec

from strands_actors.contract.driver import Driver
from strands_actors.kernel.actor import Actor, Deferred, describe
from strands_actors.kernel.frames import protocol_of
from strands_actors.kernel.health.heartbeat import Heartbeat
from strands_actors.kernel.health.processor import Standing
from strands_actors.supervisors import addresses
from strands_actors.supervisors.gate import failsafe
from strands_actors.supervisors.gate.gate import Gate
from strands_actors.supervisors.gate.memory import GateMemory
from strands_actors.supervisors.instrument import Entry, Kind
from strands_actors.supervisors.wire.watchdog import Watchdog, WatchdogMemory

from .code import build_driver
from .errors import RecordingError
from .file import Recording, entries_of, read
from .given import path_of
from .phrases import in_words
from .replay_context import Effect, ReplayContext, ReplayDeferred, answer_effect
from .rows import Gap

_EFFECTS = frozenset({Kind.ANSWERED, Kind.DEFERRED, Kind.SETTLED, Kind.SENT, Kind.SAW})


class Difference(msgspec.Struct):
    """The first step that went another way."""

    step: int
    at_s: float  # since the beginning of the recording
    actor: str
    message: str
    recorded: list[str]
    replayed: list[str]


class Outcome(msgspec.Struct):
    """``steps``: messages compared; ``skipped``: those cut off by a gap, or after one and before a
    memory."""

    equal: bool
    steps: int
    effects: int
    skipped: int
    gaps: int
    seconds: float
    difference: Difference | None


class _Player:
    """One actor in a replay context, and the step that is being gathered."""

    def __init__(self, actor: Actor, context: ReplayContext, effects: list[Effect], world: list[bytes]) -> None:
        self.actor = actor
        self.context = context
        self.decode = protocol_of(type(actor)).decode
        self._effects = effects
        self._world = world
        self.taken: Entry | None = None
        self.recorded: list[Effect] = []

    def play(self) -> list[Effect]:
        """Return what it does with the message it has taken."""
        assert self.taken is not None
        self._effects.clear()
        # What it saw of the world then, it sees again.
        self._world[:] = [body for kind, _, _, body in self.recorded if kind == Kind.SAW]
        self.context.received_ns = self.taken.at_ns
        self.context.was_asked = bool(self.taken.number)
        answer = self.actor.receive(self.decode(self.taken.body))
        return self._effects + answer_effect(answer)


class Replay:
    """``driver``: built anew from what the file says, unless given."""

    def __init__(self, recording: Recording, driver: Driver | None = None) -> None:
        self._recording = recording
        self._driver = driver or build_driver(recording.info)
        self._at = addresses.of(recording.info.robot)
        self._players: dict[str, _Player] = {}
        self._began_ns = self._now_ns = 0
        self._steps = self._compared = self._skipped = self._gaps = 0

    def run(self) -> Outcome:
        difference = self._run()
        return Outcome(
            difference is None,
            self._steps,
            self._compared,
            self._skipped,
            self._gaps,
            round((self._now_ns - self._began_ns) / 1e9, 3),
            difference,
        )

    def _run(self) -> Difference | None:
        for part in self._recording.parts:
            if isinstance(part, Gap):
                self._break_off()
                continue
            for entry in entries_of(part):
                if (difference := self._feed(entry)) is not None:
                    return difference
        for name in list(self._players):
            if (difference := self._finish(name)) is not None:
                return difference
        return None

    def _feed(self, entry: Entry) -> Difference | None:
        if entry.at_ns:
            self._began_ns = self._began_ns or entry.at_ns
            self._now_ns = entry.at_ns
        kind = entry.kind
        if kind == Kind.GAP:
            self._break_off()
            return None
        player = self._players.get(entry.actor)
        if kind in _EFFECTS:
            if player is not None and player.taken is not None:
                player.recorded.append((kind, entry.number, entry.to, bytes(entry.body)))
            return None
        if kind not in (Kind.TOOK, Kind.MEMORY):
            return None
        difference = self._finish(entry.actor)
        if kind == Kind.MEMORY:
            self._players[entry.actor] = self._remember(entry)
        elif player is None:
            self._skipped += 1
        else:
            player.taken = entry
        return difference

    def _finish(self, actor: str) -> Difference | None:
        """The step of this actor is complete: play it and compare."""
        player = self._players.get(actor)
        if player is None or player.taken is None:
            return None
        taken, recorded = player.taken, player.recorded
        try:
            replayed = player.play()
        except Exception as error:  # whatever it is, it did not happen then
            replayed = [(Kind.NOTED, 0, "", msgspec.msgpack.encode(f"raised {describe(error)}"))]
        player.taken, player.recorded = None, []
        self._steps += 1
        self._compared += len(recorded)
        if replayed == recorded:
            return None
        return Difference(
            self._steps,
            round((taken.at_ns - self._began_ns) / 1e9, 6),
            actor,
            in_words(bytes(taken.body)),
            [effect_in_words(effect) for effect in recorded],
            [effect_in_words(effect) for effect in replayed],
        )

    def _break_off(self) -> None:
        """From here to the next memories nothing is known; the last steps may be cut off."""
        self._gaps += 1
        self._skipped += sum(player.taken is not None for player in self._players.values())
        self._players.clear()

    def _remember(self, entry: Entry) -> _Player:
        effects: list[Effect] = []
        world: list[bytes] = []
        context = ReplayContext(self._at.address(entry.actor), effects)
        context.deferrals = entry.number
        actor: Gate | Watchdog
        if entry.actor == "gate":
            actor = Gate(self._driver, self._at.transport, self._at.watchdog, self._at.guardian, failsafe.State())
        else:
            actor = Watchdog(
                self._driver.timing,
                self._at.gate,
                self._at.transport,
                lambda _: None,
                _RecordedHeartbeat(world),
                lambda: _standing(world),
            )
        actor.context = context
        _run_now(actor.started)

        def thing(kind: type, value: Any) -> Any:
            if kind is Deferred:
                return ReplayDeferred(effects, value)
            raise NotImplementedError(kind)

        if isinstance(actor, Gate):
            actor.recall(msgspec.msgpack.decode(entry.body, type=GateMemory, dec_hook=thing))
        else:
            actor.recall(msgspec.msgpack.decode(entry.body, type=WatchdogMemory, dec_hook=thing))
        return _Player(actor, context, effects, world)


class _RecordedHeartbeat(Heartbeat):
    """What the watchdog heard of the root then, it hears again."""

    __slots__ = ("_world",)

    def __init__(self, world: list[bytes]) -> None:
        self._world = world

    def beat(self, now_ns: int) -> None:
        """Its context has written it down."""

    @property
    def heard_ns(self) -> int:
        seen = msgspec.msgpack.decode(self._world[0]) if self._world else None
        if not isinstance(seen, int):
            return 0  # nothing new: only what is new was written down
        del self._world[0]
        return seen


def _standing(world: list[bytes]) -> Standing | None:
    return msgspec.msgpack.decode(world.pop(0), type=Standing | None) if world else None


def _run_now(started: Callable[[], Coroutine[Any, Any, None]]) -> None:
    """Run what waits for nothing."""
    try:
        started().send(None)
    except StopIteration:
        return
    raise RuntimeError("an actor that waits before its first message cannot be replayed")


def effect_in_words(effect: Effect) -> str:
    kind, number, to, body = effect
    said = in_words(body)
    match kind:
        case Kind.SENT:
            return f"tells {to}: {said}"
        case Kind.ANSWERED:
            return f"answers: {said}"
        case Kind.DEFERRED:
            return f"answers later (number {number})"
        case Kind.SETTLED:
            return f"answers number {number}: {said}"
        case Kind.SAW:
            return f"sees: {said}"
        case _:
            return said


def replay(recording: Recording | str | os.PathLike[str], driver: Driver | None = None) -> Outcome:
    """Once through a recording, or the file of one. Raise ``RecordingError`` when its driver is not
    here, or it is of another version, and what ``read`` raises."""
    if not isinstance(recording, Recording):
        recording = read(path_of("replay", "recording", recording))
    try:
        return Replay(recording, driver).run()
    except msgspec.MsgspecError as error:
        written = recording.info.version
        raise RecordingError(f"what strands-actors {written} wrote cannot be read here: {error}") from error
