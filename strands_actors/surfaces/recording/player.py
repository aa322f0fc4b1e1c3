"""Replay a recording: feed the recorded messages to a gate and a watchdog, with the recorded times, and
compare every decision.

A step is one message to an actor with all its effects. Effects are the answer, the messages that the actor
sends (to the transport, the guardian, the watchdog), and answers to earlier messages. Effects are compared byte
by byte.

The recording also has snapshots of each actor's state ("memory"). The replay of an actor begins with its first
memory. After a gap in the recording, the steps up to the actor's next memory are skipped.
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
from strands_actors.kernel.health.processor import ProcessorUse
from strands_actors.supervisors import addresses
from strands_actors.supervisors.gate import failsafe
from strands_actors.supervisors.gate.gate import Gate
from strands_actors.supervisors.gate.memory import GateMemory
from strands_actors.supervisors.instrument import Entry, Kind
from strands_actors.supervisors.wire.watchdog import Watchdog, WatchdogMemory

from .arguments import path_of
from .code import build_driver
from .errors import RecordingError
from .file import Recording, entries_of, read
from .phrases import in_words
from .replay_context import Effect, ReplayContext, ReplayDeferred, answer_effect
from .rows import Gap

_EFFECTS = frozenset({Kind.ANSWERED, Kind.DEFERRED, Kind.SETTLED, Kind.SENT, Kind.SAW})


class Difference(msgspec.Struct):
    """The first step (message to an actor) that had other effects in the replay than in the recording."""

    step: int
    at_s: float  # Time of the step, in seconds from the beginning of the recording.
    actor: str
    message: str
    recorded: list[str]
    replayed: list[str]


class Outcome(msgspec.Struct):
    """The result of a replay.

    Attributes:
        equal: True if all steps had the recorded effects.
        steps: Number of messages that were replayed.
        effects: Number of effects (answers and sent messages) that were compared.
        skipped: Number of messages that could not be replayed, because the actor's state was not known.
        gaps: Number of gaps.
        seconds: Length of the replayed part.
        difference: The first difference; None if there is no difference.
    """

    equal: bool
    steps: int
    effects: int
    skipped: int
    gaps: int
    seconds: float
    difference: Difference | None


class _Player:
    """One actor of a replay, and the recorded effects of its present step."""

    def __init__(self, actor: Actor, context: ReplayContext, effects: list[Effect], world: list[bytes]) -> None:
        self.actor = actor
        self.context = context
        self.decode = protocol_of(type(actor)).decode
        self._effects = effects
        self._world = world
        self.entry: Entry | None = None
        self.recorded: list[Effect] = []

    def play(self) -> list[Effect]:
        """Pass the message of the present step to the actor, and return the effects."""
        assert self.entry is not None
        self._effects.clear()
        # Values that the actor reads from outside, such as heartbeats, also come from the recording.
        self._world[:] = [body for entry_kind, _, _, body in self.recorded if entry_kind == Kind.SAW]
        self.context.received_ns = self.entry.at_ns
        self.context.is_request = bool(self.entry.number)
        answer = self.actor.receive(self.decode(self.entry.body))
        return self._effects + answer_effect(answer)


class Replay:
    """A replay of one recording.

    Args:
        recording: The recording.
        driver: The driver. Default: built from the recording.
    """

    def __init__(self, recording: Recording, driver: Driver | None = None) -> None:
        self._recording = recording
        self._driver = driver or build_driver(recording.info)
        self._actors = addresses.of(recording.info.robot)
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
        entry_kind = entry.kind
        if entry_kind == Kind.GAP:
            self._break_off()
            return None
        player = self._players.get(entry.actor)
        if entry_kind in _EFFECTS:
            if player is not None and player.entry is not None:
                player.recorded.append((entry_kind, entry.number, entry.to, bytes(entry.body)))
            return None
        if entry_kind not in (Kind.TOOK, Kind.MEMORY):
            return None
        difference = self._finish(entry.actor)
        if entry_kind == Kind.MEMORY:
            self._players[entry.actor] = self._remember(entry)
        elif player is None:
            self._skipped += 1
        else:
            player.entry = entry
        return difference

    def _finish(self, actor: str) -> Difference | None:
        """Replay an actor's step when all its recorded effects are known. Return the difference, or None."""
        player = self._players.get(actor)
        if player is None or player.entry is None:
            return None
        entry, recorded = player.entry, player.recorded
        try:
            replayed = player.play()
        except Exception as error:  # The recorded step raised no exception, so any exception is a difference.
            replayed = [(Kind.NOTED, 0, "", msgspec.msgpack.encode(f"raised {describe(error)}"))]
        player.entry, player.recorded = None, []
        self._steps += 1
        self._compared += len(recorded)
        if replayed == recorded:
            return None
        return Difference(
            self._steps,
            round((entry.at_ns - self._began_ns) / 1e9, 6),
            actor,
            in_words(bytes(entry.body)),
            [effect_in_words(effect) for effect in recorded],
            [effect_in_words(effect) for effect in replayed],
        )

    def _break_off(self) -> None:
        """Handle a gap in the recording: drop each actor until the next snapshot of its state ("memory").
        The present step of an actor may be incomplete, so it is skipped."""
        self._gaps += 1
        self._skipped += sum(player.entry is not None for player in self._players.values())
        self._players.clear()

    def _remember(self, entry: Entry) -> _Player:
        effects: list[Effect] = []
        world: list[bytes] = []
        context = ReplayContext(self._actors.address(entry.actor), effects)
        context.deferrals = entry.number
        actor: Gate | Watchdog
        if entry.actor == "gate":
            actor = Gate(
                self._driver,
                self._actors.transport,
                self._actors.watchdog,
                self._actors.guardian,
                failsafe.State(),
            )
        else:
            actor = Watchdog(
                self._driver.timing,
                self._actors.gate,
                self._actors.transport,
                lambda _: None,
                _RecordedHeartbeat(world),
                lambda: _standing(world),
            )
        actor.context = context
        _run_now(actor.started)

        def thing(expected_type: type, value: Any) -> Any:
            if expected_type is Deferred:
                return ReplayDeferred(effects, value)
            raise NotImplementedError(expected_type)

        if isinstance(actor, Gate):
            actor.recall(msgspec.msgpack.decode(entry.body, type=GateMemory, dec_hook=thing))
        else:
            actor.recall(msgspec.msgpack.decode(entry.body, type=WatchdogMemory, dec_hook=thing))
        return _Player(actor, context, effects, world)


class _RecordedHeartbeat(Heartbeat):
    """Gives the recorded heartbeats of the root process to the watchdog."""

    __slots__ = ("_world",)

    def __init__(self, world: list[bytes]) -> None:
        self._world = world

    def beat(self, now_ns: int) -> None:
        """Do nothing, since a replay sends no heartbeats."""

    @property
    def last_received_ns(self) -> int:
        recorded_ns = msgspec.msgpack.decode(self._world[0]) if self._world else None
        if not isinstance(recorded_ns, int):
            return 0  # Only new heartbeats are recorded. So in this step there was no new heartbeat.
        del self._world[0]
        return recorded_ns


def _standing(world: list[bytes]) -> ProcessorUse | None:
    return msgspec.msgpack.decode(world.pop(0), type=ProcessorUse | None) if world else None


def _run_now(started: Callable[[], Coroutine[Any, Any, None]]) -> None:
    """Run a coroutine that must not wait for anything. Raise ``RuntimeError`` if it waits."""
    try:
        started().send(None)
    except StopIteration:
        return
    raise RuntimeError("an actor that waits for something when it starts cannot be replayed")


def effect_in_words(effect: Effect) -> str:
    effect_kind, number, to, body = effect
    text = in_words(body)
    match effect_kind:
        case Kind.SENT:
            return f"tells {to}: {text}"
        case Kind.ANSWERED:
            return f"answers: {text}"
        case Kind.DEFERRED:
            return f"answers later (number {number})"
        case Kind.SETTLED:
            return f"answers number {number}: {text}"
        case Kind.SAW:
            return f"sees: {text}"
        case _:
            return text


def replay(recording: Recording | str | os.PathLike[str], driver: Driver | None = None) -> Outcome:
    """Replay a recording.

    Args:
        recording: The recording, or its file.
        driver: The driver. Default: built from the recording.

    Returns:
        The result, with the first difference if there is one.

    Raises:
        RecordingError: The robot's driver is not installed, the recording is of an unsupported version, or
            ``read`` has failed.
        OSError: The file cannot be read.
    """
    if not isinstance(recording, Recording):
        recording = read(path_of("replay", "recording", recording))
    try:
        return Replay(recording, driver).run()
    except msgspec.MsgspecError as error:
        written = recording.info.version
        raise RecordingError(
            f"the recording of strands-actors {written} cannot be decoded by this version: {error}"
        ) from error
