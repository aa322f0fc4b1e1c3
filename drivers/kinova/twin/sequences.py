"""Play sequences: their actions one after the other, in the order of the tasks."""

from __future__ import annotations

import enum
from collections.abc import Callable
from typing import NamedTuple

from strands_actors.drivers.common.codecs import protobuf as pb
from strands_actors.drivers.kinova.protocol import SubError

from . import messages as m
from .actions import Actions
from .errors import CallFailed
from .functions import ACTIONS, Function
from .messages import Action
from .stores import Changed, Store
from .topics import Topics, timestamp

HANDLE_FIELD = 4


class Event(enum.IntEnum):
    """``EventIdSequenceInfoNotification`` of the vendor."""

    COMPLETED = 1
    ABORTED = 2
    TASK_STARTED = 4
    TASK_COMPLETED = 5
    STARTED = 6


class Sequence(NamedTuple):
    actions: tuple[Action, ...]
    rest: bytes  # the encoded fields except the handle


class Sequences:
    def __init__(
        self,
        actions: Actions,
        topics: Topics,
        set_playing: Callable[[bool], None],
        is_ready: Callable[[], bool],
        changed: Changed,
    ) -> None:
        """Args:
        actions: Carries out the actions.
        topics: Gets the events.
        set_playing: Called with True at the start of a sequence, and with False at its end.
        is_ready: Returns True if the arm may move on.
        changed: See ``Store``.
        """
        self._actions = actions
        self._topics = topics
        self._set_playing = set_playing
        self._is_ready = is_ready
        self.store: Store[Sequence] = Store(HANDLE_FIELD, changed)
        self.reset()

    def reset(self) -> None:
        self.store.reset({})
        self._number = 0  # the number of the playing sequence; 0 if no sequence plays

    def create(self, payload: bytes) -> bytes:
        """Store a sequence, and return its handle. Raise ``CallFailed`` for an action that is not modelled."""
        fields = pb.message(payload)
        actions = tuple(m.decode_action(pb.last_bytes(task, 2)) for task in m.sub_messages(fields, 4))
        if not actions:
            raise CallFailed(SubError.INVALID_PARAM, "the sequence has no tasks")
        for action in actions:
            if action.kind not in ACTIONS:
                raise CallFailed(SubError.UNSUPPORTED_ACTION, f"action type {action.kind}")
        kept = [(number, value) for number in (2, 3, 4) for value in fields.get(number, ())]
        rest = b"".join(pb.bytes_field(number, value) for number, value in kept if isinstance(value, bytes))
        return m.Handle(self.store.add(Sequence(actions, rest))).encode()

    def read(self, payload: bytes) -> bytes:
        number = m.identifier_of(payload)
        return self._encode(number, self.store.get(number))

    def read_all(self) -> bytes:
        return self.store.encode_all(self._encode)

    @staticmethod
    def _encode(number: int, sequence: Sequence) -> bytes:
        return pb.bytes_field(1, m.Handle(number).encode()) + sequence.rest

    def play(self, payload: bytes) -> None:
        number = m.identifier_of(payload)
        sequence = self.store.get(number)
        self._actions.abort(SubError.MANUAL_STOP)
        self._number = number
        self._set_playing(True)
        self._publish(Event.STARTED)
        self._begin(sequence, 0)

    def stop(self) -> None:
        """Stop the playing sequence. Raise ``CallFailed`` if no sequence plays."""
        if not self._number:
            raise CallFailed(SubError.NO_ACTION, "no sequence plays")
        self._actions.abort(SubError.MANUAL_STOP)

    def _begin(self, sequence: Sequence, index: int) -> None:
        if index == len(sequence.actions):
            self._finish(Event.COMPLETED, index - 1)
            return
        if not self._is_ready():
            self._finish(Event.ABORTED, index, SubError.ROBOT_IN_FAULT)
            return

        def ended(sub_error: SubError) -> None:
            if sub_error is not SubError.NONE:
                self._finish(Event.ABORTED, index, sub_error)
                return
            self._publish(Event.TASK_COMPLETED, index)
            self._begin(sequence, index + 1)

        self._publish(Event.TASK_STARTED, index)
        try:
            self._actions.execute(sequence.actions[index], ended)
        except CallFailed as failed:
            self._finish(Event.ABORTED, index, failed.sub_error)

    def _finish(self, event: Event, index: int, sub_error: SubError = SubError.NONE) -> None:
        self._publish(event, index, sub_error)
        self._number = 0
        self._set_playing(False)

    def _publish(self, event: Event, index: int = 0, sub_error: SubError = SubError.NONE) -> None:
        payload = (
            pb.varint_field(1, event)
            + pb.bytes_field(2, m.Handle(self._number).encode())
            + pb.varint_field(3, index)
            + pb.bytes_field(5, timestamp())
            + pb.varint_field(7, sub_error)
        )
        self._topics.publish(Function.SEQUENCE_INFO_TOPIC, payload)
