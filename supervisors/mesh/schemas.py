"""What is said on the mesh: keys, schemas and JSON, for both of its ends.

Telemetry keeps the keys and the field names of strands-robots (``robot_id``, ``peer_id``, ``t``,
``joints``), so that a subscriber written for it can read ours. Wall-clock seconds are ``t`` and
``timestamp``; whatever decides something is CLOCK_MONOTONIC nanoseconds of the robot's host.
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
"""Anything larger is dropped before it is put together; up to here a refusal says how large it
was."""

ESTOP_KEY = f"{PREFIX}/safety/estop"
RESUME_KEY = f"{PREFIX}/safety/resume"
EVENT_KEY = f"{PREFIX}/safety/event"
BROADCAST_KEY = f"{PREFIX}/broadcast"

ESTOP_ANSWER_S = 0.25
"""Within this time of an e-stop every robot that can be reached has said what became of it."""

TELEMETRY = ("presence", "state", "health", *TOPICS_HZ)
"""What a robot may publish below ``strands/<robot>/``."""

_NAME = re.compile(r"[A-Za-z0-9_.-]{1,64}\Z")


def is_name(text: str) -> bool:
    """Return whether it can be one part of a key: no wildcard, no slash."""
    return bool(_NAME.match(text))


def key(robot: str, topic: str) -> str:
    return f"{PREFIX}/{robot}/{topic}"


def command_key(robot: str, sender: str) -> str:
    """Return the key on which a sender asks a robot. Who asks is known by it: access rules let nobody
    ask in another's name."""
    return key(robot, f"cmd/{sender}")


def camera_topic(camera: str) -> str:
    """Its pictures, as JPEG. ``*``: of all cameras."""
    return f"camera/{camera}"


def schema(topic: str) -> str:
    return f"strands.{topic.replace('/', '.')}.v1"


def response_key(sender: str, robot: str, turn: str) -> str:
    """Return where a sender hears an answer. Of a stop without a turn the last part is ``-``."""
    return f"{PREFIX}/{sender}/response/{robot}/{turn or '-'}"


# -- commands

Name = Annotated[str, msgspec.Meta(pattern=r"^[A-Za-z0-9_.-]{1,64}\Z")]
MAX_TEXT = 256
Text = Annotated[str, msgspec.Meta(max_length=MAX_TEXT)]
PRIVATE = "~"
"""In the name of a sender that proves who it is, and of a turn that is answered to it alone. No name that
somebody gives has it."""


def proven(sender: str, proof: str) -> str:
    """Return whose leases are meant: of programs that ask by one name, each has its own."""
    return f"{sender}{PRIVATE}{hashlib.sha256(proof.encode()).hexdigest()[:16]}"


def plain(sender: str) -> str:
    """Return a sender's name as others know it."""
    return sender.partition(PRIVATE)[0]


class Envelope(msgspec.Struct, frozen=True):
    """Around each command. Fields that are not named here are ignored. ``sender_id``: of what is put,
    under which name it is answered; who asks is known by the key. ``proof``: of a question, a
    secret of the program that asks."""

    sender_id: Name
    turn_id: Name
    command: msgspec.Raw
    target_id: str = ""
    proof: Annotated[str, msgspec.Meta(max_length=64)] = ""


class Sender(msgspec.Struct, frozen=True):
    """Of an envelope that could not be read: whom to tell."""

    sender_id: Name
    turn_id: Name


class Command(msgspec.Struct, frozen=True, forbid_unknown_fields=True, tag_field="action", tag=str.lower):
    """``{"action": <class name in lower case>, ...}``."""

    @property
    def action(self) -> str:
        return str(type(self).__struct_config__.tag)


class Dated(Command, frozen=True):
    """May not be obeyed later than ``deadline_ns``, a time of the robot's clock; ``clock`` is what
    the robot answered to a ``sync`` of the same sender: without it the sender cannot know that
    clock."""

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
    """Keeps the lease, for a second. Not answered. ``answered_ago_s``: when the thread that
    commands last did anything but compute; negative: not since the last beat."""

    lease: int
    answered_ago_s: Annotated[float, msgspec.Meta(ge=-1.0, le=60.0)] = 0.0


class Release(Command, frozen=True):
    lease: int


class Move(Dated, frozen=True):
    """A target by joint. ``latched``: kept for as long as the lease is, otherwise until the
    deadline."""

    targets: Annotated[dict[Text, float | bool | Text | None], msgspec.Meta(min_length=1, max_length=64)]
    lease: int
    epoch: int
    period_s: Annotated[float, msgspec.Meta(ge=0.0, le=10.0)] = 0.0
    latched: bool = False


# -- the words of strands-robots for reading


class Ping(Command, frozen=True):
    """Is it there? Nothing is read of the robot, and nobody is refused."""


class State(Command, frozen=True):
    """What stands on ``state``, now."""


class Features(Command, frozen=True):
    """Which keys an action and an observation have."""


class DescribeTool(Command, frozen=True, tag="describe_tool"):
    """The tool's spec, as an agent has it."""


class TeleopStatus(Command, frozen=True, tag="teleop_status"):
    pass


# -- and for moving: under a lease that the robot takes for the sender


class Motion(Dated, frozen=True):
    """What moves the robot for longer than the message lives."""


class Start(Motion, frozen=True):
    """Run a policy that is installed on the robot's host. Answered when it has begun."""

    instruction: Annotated[str, msgspec.Meta(min_length=1, max_length=2000)]
    policy_provider: Annotated[str, msgspec.Meta(min_length=1, max_length=64)]
    policy_host: Text = "localhost"
    policy_port: Annotated[int, msgspec.Meta(ge=1, le=65535)] | None = None
    duration: Annotated[float, msgspec.Meta(gt=0.0, le=3600.0)] = 30.0
    n_steps: Annotated[int, msgspec.Meta(ge=0, le=10_000_000)] = 0
    control_frequency: Annotated[float, msgspec.Meta(gt=0.0, le=1000.0)] | None = None


class Execute(Start, frozen=True):
    """As ``start``, and answered once more when it has ended."""


class SetJoints(Motion, frozen=True, tag="set_joints"):
    """Go to a pose, and stay there for ``duration`` seconds; then it is held."""

    target_joints: Annotated[dict[Text, float], msgspec.Meta(min_length=1, max_length=64)]
    duration: Annotated[float, msgspec.Meta(gt=0.0, le=10.0)] = 2.0


class Step(Motion, frozen=True):
    """Let time pass in a simulation."""

    steps: Annotated[int, msgspec.Meta(ge=1, le=1_000_000)] = 1


class Reset(Motion, frozen=True):
    """Put a simulation back to where it began."""


class Stop(Command, frozen=True):
    """As our own programs send it; a robot obeys any form (``stop_rules.py``), of ``Estop`` too."""

    by: Text = ""


class Estop(Command, frozen=True):
    by: Text = ""


class Resume(Dated, frozen=True):
    by: Text = ""


Leased = Beat | Release | Move

READING: tuple[type[Command], ...] = (Status, Observe, Ping, State, Features, DescribeTool, TeleopStatus)
"""Of these nobody needs a lease."""

WRITING: tuple[type[Command], ...] = (Acquire, Beat, Release, Move, Start, Execute, SetJoints, Step, Reset)
ORDERS: tuple[type[Command], ...] = (Stop, Estop, Resume)

PUT: tuple[type[Command], ...] = (*READING, Stop, Estop)
"""What may be put: who put it is not known, and everybody may hear the answer."""

_KINDS: tuple[type[Command], ...] = (Sync,) + READING + WRITING + ORDERS  # noqa: RUF005  # typed so
ACTIONS: dict[str, type[Command]] = {str(kind.__struct_config__.tag): kind for kind in _KINDS}


class SafetyOrder(msgspec.Struct, frozen=True):
    """On ``strands/safety/estop`` and ``resume``. An e-stop needs none of it, and is for all unless
    it names one robot; a resume is refused to who put it. ``by`` may be anything: who sends what is
    no name is answered all the same."""

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
    """``type``: response or error. ``final``: an e-stop that takes long is answered twice."""

    type: str
    responder_id: str
    turn_id: str
    timestamp: float
    result: dict[str, Any] = msgspec.field(default_factory=dict)
    error: str = ""
    refused: Refusal | None = None
    final: bool = True


encode = msgspec.json.Encoder().encode
