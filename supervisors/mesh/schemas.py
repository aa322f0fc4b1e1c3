"""Keys, schemas and JSON messages of the mesh, for robots and their peers.

Telemetry keeps the keys and the field names of strands-robots (``robot_id``, ``peer_id``, ``t``,
``joints``), so that a subscriber written for strands-robots can read it. ``t`` and ``timestamp`` are
wall-clock seconds. Times on which a decision depends are CLOCK_MONOTONIC nanoseconds of the robot's
host.
"""

from __future__ import annotations

import hashlib
import re
from typing import Annotated, Any

import msgspec

from strands_actors.contract.sensors import TOPICS_HZ
from strands_actors.kernel.node import PREFIX

MAX_COMMAND_BYTES = 16 * 1024
MAX_SAFETY_BYTES = 4 * 1024
MAX_MESSAGE_BYTES = 128 * 1024
"""A larger message is dropped before it is reassembled. Up to this size, a refusal reports the size."""

ESTOP_KEY = f"{PREFIX}/safety/estop"
RESUME_KEY = f"{PREFIX}/safety/resume"
EVENT_KEY = f"{PREFIX}/safety/event"
BROADCAST_KEY = f"{PREFIX}/broadcast"

ESTOP_ANSWER_S = 0.25
"""Within this time after an e-stop, every reachable robot has answered: with its result, or that the stop is
not confirmed yet."""

TELEMETRY = ("presence", "state", "health", *TOPICS_HZ)
"""Topics that a robot may publish below ``strands/<robot>/``."""

_NAME = re.compile(r"[A-Za-z0-9_.-]{1,64}\Z")


def is_name(text: str) -> bool:
    """Return True if the text can be one part of a key: no wildcard, no slash."""
    return bool(_NAME.match(text))


def key(robot: str, topic: str) -> str:
    return f"{PREFIX}/{robot}/{topic}"


def command_key(robot: str, sender: str) -> str:
    """Return the key on which a sender asks a robot. It identifies the sender, since the access rules
    allow each peer only the keys with its own name."""
    return key(robot, f"cmd/{sender}")


def camera_topic(camera: str) -> str:
    """Return the topic of a camera's JPEG pictures. ``*`` stands for all cameras."""
    return f"camera/{camera}"


def schema(topic: str) -> str:
    return f"strands.{topic.replace('/', '.')}.v1"


def response_key(sender: str, robot: str, turn: str) -> str:
    """Return the key on which a sender receives an answer. Its last part is ``-`` for a stop without a
    turn."""
    return f"{PREFIX}/{sender}/response/{robot}/{turn or '-'}"


# -- commands

Name = Annotated[str, msgspec.Meta(pattern=r"^[A-Za-z0-9_.-]{1,64}\Z")]
MAX_TEXT = 256
Text = Annotated[str, msgspec.Meta(max_length=MAX_TEXT)]
PRIVATE = "~"
"""Separator within the name of a sender with a proof, and of a turn that is answered in private. A name
from outside cannot contain it."""


def proven(sender: str, proof: str) -> str:
    """Return the name of a sender with its proof. Programs that ask under the same name differ in it, so
    that each has its own leases."""
    return f"{sender}{PRIVATE}{hashlib.sha256(proof.encode()).hexdigest()[:16]}"


def plain(sender: str) -> str:
    """Return the public part of a sender's name."""
    return sender.partition(PRIVATE)[0]


class Envelope(msgspec.Struct, frozen=True):
    """The envelope of each command. Unknown fields are ignored.

    Attributes:
        sender_id: The name under which a command that was put is answered. A query (a zenoh get) is
            identified by its key instead.
        turn_id: The sender's name for this command.
        command: The command.
        target_id: The robot that is meant; empty for the one that owns the key.
        proof: For a query, a secret of the program that asks.
    """

    sender_id: Name
    turn_id: Name
    command: msgspec.Raw
    target_id: str = ""
    proof: Annotated[str, msgspec.Meta(max_length=64)] = ""


class Sender(msgspec.Struct, frozen=True):
    """The address for a refusal, from an envelope that could not be read as a whole."""

    sender_id: Name
    turn_id: Name


class Command(msgspec.Struct, frozen=True, forbid_unknown_fields=True, tag_field="action", tag=str.lower):
    """``{"action": <class name in lower case>, ...}``."""

    @property
    def action(self) -> str:
        return str(type(self).__struct_config__.tag)


class Dated(Command, frozen=True):
    """A command with a deadline.

    Attributes:
        clock: The robot's answer to a ``sync`` of the same sender. It proves that the sender knows the
            robot's clock.
        deadline_ns: A time of the robot's clock. The command is not carried out later.
    """

    clock: Name
    deadline_ns: int


class Sync(Command, frozen=True):
    """Ask for the robot's clock."""


class Status(Command, frozen=True):
    pass


class Observe(Command, frozen=True):
    pass


class Acquire(Dated, frozen=True):
    """Ask for the right to move the robot."""


class Beat(Dated, frozen=True):
    """Keep the lease for another second. There is no answer.

    Attributes:
        lease: The lease.
        answered_ago_s: Seconds since the sender's thread that commands did anything except compute.
            Negative: it has not since the last beat.
    """

    lease: int
    answered_ago_s: Annotated[float, msgspec.Meta(ge=-1.0, le=60.0)] = 0.0


class Release(Command, frozen=True):
    lease: int


class Move(Dated, frozen=True):
    """Set a target for some joints. It stays in force until the deadline, or until the lease ends if it is
    ``latched``."""

    targets: Annotated[dict[Text, float | bool | Text | None], msgspec.Meta(min_length=1, max_length=64)]
    lease: int
    epoch: int
    period_s: Annotated[float, msgspec.Meta(ge=0.0, le=10.0)] = 0.0
    latched: bool = False


# -- commands of strands-robots that read


class Ping(Command, frozen=True):
    """Ask if the robot is on the mesh. Nothing is read from the robot, and no sender is refused."""


class State(Command, frozen=True):
    """Ask for the present value of the topic ``state``."""


class Features(Command, frozen=True):
    """Ask for the keys of actions and observations."""


class DescribeTool(Command, frozen=True, tag="describe_tool"):
    """Ask for the spec of the tool that agents use."""


class TeleopStatus(Command, frozen=True, tag="teleop_status"):
    pass


# -- commands of strands-robots that move, under a lease that the robot acquires for the sender


class Motion(Dated, frozen=True):
    """A command that moves the robot beyond the deadline of its message."""


class Start(Motion, frozen=True):
    """Run a policy that is installed on the robot's host. The answer comes when it has begun."""

    instruction: Annotated[str, msgspec.Meta(min_length=1, max_length=2000)]
    policy_provider: Annotated[str, msgspec.Meta(min_length=1, max_length=64)]
    policy_host: Text = "localhost"
    policy_port: Annotated[int, msgspec.Meta(ge=1, le=65535)] | None = None
    duration: Annotated[float, msgspec.Meta(gt=0.0, le=3600.0)] = 30.0
    n_steps: Annotated[int, msgspec.Meta(ge=0, le=10_000_000)] = 0
    control_frequency: Annotated[float, msgspec.Meta(gt=0.0, le=1000.0)] | None = None


class Execute(Start, frozen=True):
    """As ``start``, with a second answer when the policy has ended."""


class SetJoints(Motion, frozen=True, tag="set_joints"):
    """Command a pose for ``duration`` seconds. Then the robot holds."""

    target_joints: Annotated[dict[Text, float], msgspec.Meta(min_length=1, max_length=64)]
    duration: Annotated[float, msgspec.Meta(gt=0.0, le=10.0)] = 2.0


class Step(Motion, frozen=True):
    """Advance a simulation."""

    steps: Annotated[int, msgspec.Meta(ge=1, le=1_000_000)] = 1


class Reset(Motion, frozen=True):
    """Put a simulation back to its initial state."""


class Stop(Command, frozen=True):
    """The form in which our own programs send a stop. A robot accepts any form of ``Stop`` and ``Estop``
    (``stop_rules.py``)."""

    by: Text = ""


class Estop(Command, frozen=True):
    by: Text = ""


class Resume(Dated, frozen=True):
    by: Text = ""


Leased = Beat | Release | Move

READING: tuple[type[Command], ...] = (Status, Observe, Ping, State, Features, DescribeTool, TeleopStatus)
"""Commands that need no lease."""

WRITING: tuple[type[Command], ...] = (Acquire, Beat, Release, Move, Start, Execute, SetJoints, Step, Reset)
ORDERS: tuple[type[Command], ...] = (Stop, Estop, Resume)

PUT: tuple[type[Command], ...] = (*READING, Stop, Estop)
"""Commands that a sender may put. The sender of a put is unknown, and every peer may receive the answer."""

_KINDS: tuple[type[Command], ...] = (Sync,) + READING + WRITING + ORDERS  # noqa: RUF005  # typed so
ACTIONS: dict[str, type[Command]] = {str(kind.__struct_config__.tag): kind for kind in _KINDS}


class SafetyOrder(msgspec.Struct, frozen=True):
    """A sample on ``strands/safety/estop`` or ``resume``.

    An e-stop needs no field. It is for all robots unless ``target_id`` names one. A resume that was put
    is refused. ``by`` may have any type: a sender whose ``by`` is not a name is answered, too.
    """

    sender_id: str = ""
    turn_id: str = ""
    target_id: str = ""
    by: Any = ""


# -- answers


class Refusal(msgspec.Struct, frozen=True, omit_defaults=True):
    code: str
    reason: str
    remedy: str = ""
    offered: str = ""
    limit: str = ""
    verb: str = ""
    because: str = ""


class Response(msgspec.Struct, frozen=True, omit_defaults=True):
    """The answer to a command.

    Attributes:
        type: ``response`` or ``error``.
        responder_id: The robot.
        turn_id: The turn of the command.
        timestamp: Wall-clock seconds.
        result: The result of a command that was carried out.
        error: The text of the refusal.
        refused: The refusal.
        final: False for an interim answer that another one follows, for example for a slow e-stop.
    """

    type: str
    responder_id: str
    turn_id: str
    timestamp: float
    result: dict[str, Any] = msgspec.field(default_factory=dict)
    error: str = ""
    refused: Refusal | None = None
    final: bool = True


encode = msgspec.json.Encoder().encode
