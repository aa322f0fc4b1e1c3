"""Keys, schemas and JSON messages of the mesh, for robots and their peers.

Telemetry has the same keys and field names as in strands-robots (``robot_id``, ``peer_id``, ``t``, ``joints``), so
that its subscribers can read it. ``t`` and ``timestamp`` are wall-clock seconds. Times that are used for decisions
are nanoseconds of CLOCK_MONOTONIC on the robot's host.
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
    """Return the key on which a sender sends queries to a robot. The key proves the sender, since the access rules
    allow each peer only the keys with its own name."""
    return key(robot, f"cmd/{sender}")


def camera_topic(camera: str) -> str:
    """Return the topic of a camera's JPEG pictures. ``*`` stands for all cameras."""
    return f"camera/{camera}"


def schema(topic: str) -> str:
    return f"strands.{topic.replace('/', '.')}.v1"


def response_key(sender: str, robot: str, turn: str) -> str:
    """Return the key on which a sender receives an answer. The last part is ``-`` for a stop without a turn id."""
    return f"{PREFIX}/{sender}/response/{robot}/{turn or '-'}"


# -- commands to a robot

Name = Annotated[str, msgspec.Meta(pattern=r"^[A-Za-z0-9_.-]{1,64}\Z")]
MAX_TEXT = 256
Text = Annotated[str, msgspec.Meta(max_length=MAX_TEXT)]
PRIVATE = "~"
"""Separator within the name of a sender with a proof, and of a turn that is answered in private. A name
from outside cannot contain it."""


def proven(sender: str, proof: str) -> str:
    """Return the name of a sender together with its secret proof. Two programs with the same name have different
    proofs, so that each has its own leases."""
    return f"{sender}{PRIVATE}{hashlib.sha256(proof.encode()).hexdigest()[:16]}"


def plain(sender: str) -> str:
    """Return a sender's name without its secret proof."""
    return sender.partition(PRIVATE)[0]


class Envelope(msgspec.Struct, frozen=True):
    """The envelope of each command. Unknown fields are ignored.

    Attributes:
        sender_id: Name of the sender. The answer to a published command (zenoh put) is sent under it. The sender of
            a query (zenoh get) is known from the key instead.
        turn_id: Id of this command, chosen by the sender.
        command: The command.
        target_id: Name of the robot; empty for the robot whose key is used.
        proof: For a query: a secret of the sending program.
    """

    sender_id: Name
    turn_id: Name
    command: msgspec.Raw
    target_id: str = ""
    proof: Annotated[str, msgspec.Meta(max_length=64)] = ""


class Sender(msgspec.Struct, frozen=True):
    """The sender of an envelope that could not be decoded as a whole. A refusal is sent to it."""

    sender_id: Name
    turn_id: Name


class Command(msgspec.Struct, frozen=True, forbid_unknown_fields=True, tag_field="action", tag=str.lower):
    """A command. Its JSON is ``{"action": <class name in lower case>, ...}``."""

    @property
    def action(self) -> str:
        return str(type(self).__struct_config__.tag)


class Dated(Command, frozen=True):
    """A command with a deadline.

    Attributes:
        clock: The name from the robot's answer to the sender's last ``sync``. It proves that the sender knows the
            robot's clock.
        deadline_ns: Deadline on the robot's clock. The command is not carried out later.
    """

    clock: Name
    deadline_ns: int


class Sync(Command, frozen=True):
    """Read the robot's clock."""


class Status(Command, frozen=True):
    pass


class Observe(Command, frozen=True):
    pass


class Acquire(Dated, frozen=True):
    """Request the right to move the robot (a lease)."""


class Beat(Dated, frozen=True):
    """Keep the lease for another second. There is no answer.

    Attributes:
        lease: The lease.
        answered_ago_s: Seconds since the thread that sends commands last let other threads run. Negative if it has
            not done so since the last heartbeat.
    """

    lease: int
    answered_ago_s: Annotated[float, msgspec.Meta(ge=-1.0, le=60.0)] = 0.0


class Release(Command, frozen=True):
    lease: int


class Move(Dated, frozen=True):
    """Set a target for some joints. The target stays in force until the deadline. With ``latched`` it stays in
    force until the lease ends."""

    targets: Annotated[dict[Text, float | bool | Text | None], msgspec.Meta(min_length=1, max_length=64)]
    lease: int
    epoch: int
    period_s: Annotated[float, msgspec.Meta(ge=0.0, le=10.0)] = 0.0
    latched: bool = False


# -- commands of strands-robots that only read


class Ping(Command, frozen=True):
    """Ask if the robot is on the mesh. The robot is not read, and every sender is answered."""


class State(Command, frozen=True):
    """Ask for the present value of the topic ``state``."""


class Features(Command, frozen=True):
    """Ask for the keys of actions and observations."""


class DescribeTool(Command, frozen=True, tag="describe_tool"):
    """Ask for the spec of the tool that agents use."""


class TeleopStatus(Command, frozen=True, tag="teleop_status"):
    pass


# -- commands of strands-robots that move the robot; the robot acquires the lease for the sender


class Motion(Dated, frozen=True):
    """A command that moves the robot for longer than the deadline of its message."""


class Start(Motion, frozen=True):
    """Run a policy that is installed on the robot's host. The answer is sent when the policy has started."""

    instruction: Annotated[str, msgspec.Meta(min_length=1, max_length=2000)]
    policy_provider: Annotated[str, msgspec.Meta(min_length=1, max_length=64)]
    policy_host: Text = "localhost"
    policy_port: Annotated[int, msgspec.Meta(ge=1, le=65535)] | None = None
    duration: Annotated[float, msgspec.Meta(gt=0.0, le=3600.0)] = 30.0
    n_steps: Annotated[int, msgspec.Meta(ge=0, le=10_000_000)] = 0
    control_frequency: Annotated[float, msgspec.Meta(gt=0.0, le=1000.0)] | None = None


class Execute(Start, frozen=True):
    """Run a policy as ``start`` does. A second answer is sent when the policy has ended."""


class SetJoints(Motion, frozen=True, tag="set_joints"):
    """Move to a pose and keep it as the target for ``duration`` seconds. After that the robot holds."""

    target_joints: Annotated[dict[Text, float], msgspec.Meta(min_length=1, max_length=64)]
    duration: Annotated[float, msgspec.Meta(gt=0.0, le=10.0)] = 2.0


class Step(Motion, frozen=True):
    """Advance a simulation by a number of physics steps."""

    steps: Annotated[int, msgspec.Meta(ge=1, le=1_000_000)] = 1


class Reset(Motion, frozen=True):
    """Put a simulation back to its initial state."""


class Stop(Command, frozen=True):
    """Stop the robot. Our own programs use this form. A robot accepts a stop or an e-stop in any form
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
ACTIONS: dict[str, type[Command]] = {
    str(command_type.__struct_config__.tag): command_type for command_type in _KINDS
}


class SafetyOrder(msgspec.Struct, frozen=True):
    """A message on ``strands/safety/estop`` or ``strands/safety/resume``.

    An e-stop needs no field. It stops all robots unless ``target_id`` names one. A resume that was published (zenoh
    put) is refused. ``by`` and ``timestamp`` (the sender's wall-clock time in seconds) may have any type, so that a
    sender with an invalid value gets an answer, too.
    """

    sender_id: str = ""
    turn_id: str = ""
    target_id: str = ""
    by: Any = ""
    timestamp: Any = 0.0


# -- answers of a robot


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
        responder_id: Name of the robot.
        turn_id: Id of the command, as the sender chose it.
        timestamp: Wall-clock seconds.
        result: The result of a command that was carried out.
        error: The text of the refusal.
        refused: The refusal as fields.
        final: False if another answer follows, for example when an e-stop takes long.
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
