"""The catalogue of refusals: every code of this package, and the texts of the kernel's own refusals.

A code is for programs and never changes. The drivers of a robot family may add codes of the same type, in their
``refusals`` module. ``docs/refusals.md`` is generated from these tables. The functions below the tables return the
kernel's refusals: one function for each text.
"""

from __future__ import annotations

import enum
from typing import Self

from .messages import MAX_MESSAGE_BYTES, Refused


class RefusalCode(enum.StrEnum):
    """Base of a catalogue of refusal codes. ``meaning`` and ``remedy`` are texts for people."""

    meaning: str
    remedy: str

    def __new__(cls, code: str, meaning: str, remedy: str) -> Self:
        member = str.__new__(cls, code)
        member._value_ = code
        member.meaning, member.remedy = meaning, remedy
        return member


class Code(RefusalCode):
    """The refusal codes that are not specific to one family of robots."""

    # Codes about commands, and about the right to give them.
    NO_ANSWER = (
        "no_answer",
        "no answer came in time",
        "try again; `strands-actors doctor` checks whether the computer is busy",
    )
    UNREACHABLE = (
        "unreachable",
        "the answering process has ended or is silent",
        "call resume() when the robot is back",
    )
    NOT_CONNECTED = (
        "not_connected",
        "there is no link to the robot",
        "connect_eagerly(), and repair the cause that it names",
    )
    NOT_ARMED = "not_armed", "the robot is not energised", "connect_eagerly() or resume()"
    ARMING = "arming", "the robot is being energised", "wait until it is armed"
    DISARMED = "disarmed", "the robot was stopped", "resume()"
    FAULTED = "faulted", "the robot ended its motion because of a fault", "clear the fault, then resume()"
    LOCKED_OUT = "locked_out", "the robot is e-stopped", "a person lifts the lockout by resume()"
    HOLDING = "holding", "the robot holds, and the sender has not resumed it", "resume it first"
    STOPPED = "stopped", "a stop came while it was under way", "ask again"
    ENDING = "ending", "the tree of the robot ends", "start it again"
    BUSY = "busy", "the robot, or the actor that would do it, is busy", "wait until it has finished"
    RUNNING = "running", "a task or rollout runs", "stop_task(), or wait"
    LIVE = "live", "the robot is being moved", "wait until that is over, or stop()"
    NO_LEASE = "no_lease", "there is no lease", "acquire it"
    LEASE = (
        "lease",
        "another writer holds the lease, or it has lapsed",
        "wait until it is released, or stop the robot",
    )
    CHANNEL = "channel", "a process sends in the name of another one", "send in your own name"
    STALE_EPOCH = "stale_epoch", "the robot was stopped since the command was made", "send it again"
    EXPIRED = "expired", "the command is past its deadline", "send it sooner: the sender or the computer is late"
    TOO_DISTANT = "too_distant", "the deadline is too far away", "ask for a shorter time"
    CLOCK = "clock", "the sender has not read the robot's clock", "send sync first"
    LATCHED = "latched", "the robot takes no command without an end", "give it a lifetime"
    SUPERSEDED = "superseded", "a newer command replaced this one", "nothing: the newer one counts"
    NOT_APPROVED = "not_approved", "there is no approval for it", "pass approve=, or allow it in the environment"
    NO_MOTION = "no_motion", "motion is not allowed to this tool", "allow it where the tool is made"
    GUARD = "guard", "a guarded name guards nothing", "correct guarded="
    NO_DRILL = "no_drill", "no stop drill was passed, or it is too old", "run `strands-actors drill`"
    NO_STANDBY = (
        "no_standby",
        "a process that could stop the robot is missing",
        "wait until another has been started",
    )
    UNCONFIRMED = "unconfirmed", "it is not confirmed that the robot is safe", "look at the robot"
    TIMEOUT = (
        "timeout",
        "it was not done in time, and the robot was stopped for it",
        "look at the robot, then resume()",
    )
    NOTHING_RAN = "nothing_ran", "nothing of the robot ran, so that nothing was stopped", "look at the robot"
    FORKED = "forked", "a forked child does not have the robot", "call it in the parent process"

    # Codes about the content of a request.
    EMPTY = "empty", "an action names nothing", "name a joint"
    NOT_A_MAPPING = "not_a_mapping", "an action is no mapping", "give joints with numbers"
    TOO_MANY_KEYS = "too_many_keys", "an action has too many keys", "give fewer"
    UNKNOWN_JOINT = "unknown_joint", "there is no such joint", "use one that is named"
    UNKNOWN_KEY = "unknown_key", "a joint has no such value", "use one that is named"
    BOTH_SPELLINGS = "both_spellings", "a joint is given with and without `.pos`", "give one of them"
    BOTH = "both", "two inputs exclude each other", "give one of them"
    NOT_FINITE = "not_finite", "a value is no finite number", "give a finite number"
    PAST_TRAVEL = "past_travel", "a value is past its range", "stay within the range that is named"
    PAST_LIMIT = "past_limit", "a value is past its limit", "stay within the limit that is named"
    TOO_FAST = "too_fast", "a step is too large for its time", "give it more time, or a smaller step"
    RUNS_AHEAD = (
        "runs_ahead",
        "the target is far ahead of the robot",
        "send targets no quicker than the robot follows",
    )
    JUMP = "jump", "a single command would move a joint too far at full speed", "use move_to(), or raise max_jump"
    BAD_TIME = "bad_time", "a time is not one that a motion may take", "give seconds within the range that is named"
    DURATION = "duration", "a duration is not one that the robot takes", "give one within the range that is named"
    BAD_PATH = (
        "bad_path",
        "a path is not one that a robot may be moved along",
        "give rows of the same joints, at a rate",
    )
    UNKNOWN_POSE = (
        "unknown_pose",
        "a joint's position is not known",
        "use send_action(), naming all joints",
    )
    NO_POSITIONS = (
        "no_positions",
        "the robot has no joints that go to a target",
        "send_action(), or move(..., duration_s=)",
    )
    KEEPS_NO_POSE = "keeps_no_pose", "the robot keeps no pose by itself", "run a policy that keeps it"
    A_SPEED = "a_speed", "a speed has no target to reach", "move(..., duration_s=) or send_action()"
    NO_ARM = "no_arm", "the robot has no tool whose pose is computed", "move_to() with joint targets"
    BAD_POSE = "bad_pose", "a pose, or how to move there, is not given as it has to be", "give it as the text names"
    OUT_OF_REACH = "out_of_reach", "the tool cannot be brought to the pose", "give the nearest pose, which is named"
    SINGULAR = "singular", "a line passes a position where a joint would have to leap", "give linear=False"
    COLLISION = "collision", "the arm would touch itself or a space to keep out of", "give another pose"
    MOVED = "moved", "the arm moved while its motion was planned", "wait until it stands still, then ask again"
    NO_JOINT = "no_joint", "a time is given without a joint", "name a joint with it"
    NO_OBSERVATION = "no_observation", "nothing was read of the robot yet", "wait for the first reading"
    STALE = "stale", "a reading is too old", "check cable, power and network"
    UNKNOWN_SERVICE = "unknown_service", "the robot has no such service", "use one that is named"
    UNKNOWN_ARGUMENT = "unknown_argument", "a service has no such argument", "use one that is named"
    BAD_ARGUMENT = "bad_argument", "the service does not take this argument", "give one of the listed arguments"
    A_COMMAND = "a_command", "a service is a command", "send its arguments as an action"
    UNKNOWN_COMMAND = "unknown_command", "the robot has no such command", "use one that is named"
    UNKNOWN_VERB = "unknown_verb", "the tool has no such verb", "use one that is named"
    UNKNOWN_INPUT = "unknown_input", "a verb has no such input", "use one that is named"
    BAD_INPUT = (
        "bad_input",
        "an input is missing, given twice, or of the wrong type",
        "give the inputs that the text lists",
    )
    BAD_RATE = "bad_rate", "a rate of an axis is not from -1 to 1", "give one that is"
    OTHER_ROBOT = "other_robot", "the command is meant for another robot", "send it there"
    LEVEL = "level", "the robot is commanded at another level", "make the robot with the level that is named"
    NO_ROLLOUT = "no_rollout", "the robot runs no policy of this process", "send_action()"
    NO_TASK = "no_task", "the robot cannot run a policy in a separate process", "run_policy()"
    NO_TELEOP = "no_teleop", "no teleoperation runs", "attach_teleop()"
    GRIPPER_DEADMAN = (
        "gripper_deadman",
        "the dead-man of the teleoperation is the leader's gripper",
        "squeeze it twice",
    )
    ELSEWHERE = "elsewhere", "the robot is run by another host", "do it on that host"

    # Codes about states that several kinds of robots can be in.
    FAULT = "fault", "the robot reports a fault", "clear it at the robot, then resume()"
    ROBOT_MODE = (
        "robot_mode",
        "the robot is in a mode in which it takes no commands",
        "bring it to the one that is named",
    )
    MODE = "mode", "the robot is in a mode in which it does not do this", "change its mode"
    MODE_UNKNOWN = "mode_unknown", "the robot does not report its mode", "check the robot"
    MODE_STALE = "mode_stale", "the last report of the robot's mode is too old", "check the robot and the network"
    NO_STATE = "no_state", "no state of the robot has come yet", "wait for the first, or check the network"
    ROBOT = "robot", "the robot refuses it", "look at the robot"
    REFUSED_BY_ROBOT = "refused_by_robot", "the robot refuses it", "look at the robot, then try again"
    MOTORS_OFF = "motors_off", "the motors have no power", "energise them by the service that is named"
    BATTERY = "battery", "the battery is too low, or its state is not known", "charge it"

    # Codes about messages between processes and hosts.
    MALFORMED = "malformed", "a message cannot be read", "send the fields that the text lists"
    MALFORMED_REPLY = "malformed_reply", "an answer cannot be read", "the two sides have different versions"
    OVERSIZED = "oversized", "a message is too large", "send less"
    WRONG_TYPE = "wrong_type", "an actor does not take such a message", "send one that it takes"
    MAILBOX_FULL = "mailbox_full", "an actor has too many messages waiting", "wait"
    UNKNOWN_ADDRESS = "unknown_address", "no process has this address", "the robot may have ended"
    GONE = "gone", "an actor ended before it read the message", "the robot may have ended"
    CRASHED = "crashed", "an actor failed", "read the log"
    PUBLISH = "publish", "the gate did not answer a rollout", "the computer may be busy"
    NOT_ALLOWED = "not_allowed", "faults may not be made", "set the variable that is named"
    UNKNOWN_FAULT = "unknown_fault", "there is no such fault", "use one that is named"
    GIVEN_UP = (
        "given_up",
        "the robot ended a recording early",
        "give the recorder more of the computer",
    )
    FORMAT = "format", "a recorder has another format", "use the robot's version"

    # Codes about commands that come over the mesh.
    PUT = "put", "the sender of a published command is not known", "send it as a zenoh query"
    TARGET = "target", "the command is for another robot", "ask on that robot's key"
    NOT_A_REQUEST = "told", "a request was sent without waiting for its answer", "send it as a query"
    DUPLICATE = "duplicate", "the command was already done", "give each command a new turn_id"
    RATE = "rate", "more commands come than are let through", "send fewer"
    UNKNOWN_ACTION = "unknown_action", "there is no such action", "send one that is named"
    NOT_HERE = "not_here", "an action of strands-robots that does not exist here", "use the alternative in the text"
    ONE_ROBOT = "one_robot", "the command moves one robot, and was sent to several", "send it to one"
    NO_SIMULATION = "no_simulation", "the robot is no simulation", "start, set_joints and move drive a robot"
    TOO_LONG = "too_long", "the robot keeps no command for so long", "give a shorter duration, or run a policy"
    BAD_POLICY = (
        "bad_policy",
        "the policy is not one that may run here",
        "name one that is installed, or allow the host",
    )
    ERROR = "error", "the robot refused it without a code", "read its text"

    # Codes about processes and their resources.
    NO_PROCESS = "no_process", "no process can be started", "try again"
    NO_RESERVE = (
        "no_reserve",
        "a process could not stop the robot for want of memory or files",
        "close other programs",
    )
    NO_DESCRIPTOR = "no_descriptor", "a port cannot be handed to another process", "raise the limit of open files"
    NO_STOP_CHANNEL = (
        "no_stop_channel",
        "a process has no stop channel to the hardware",
        "wait: the process tries again",
    )


# -- delivery within a process


def superseded() -> Refused:
    return Refused(Code.SUPERSEDED, "a newer message of the same sender replaced this one")


def mailbox_full(address: str, waiting: int) -> Refused:
    return Refused(Code.MAILBOX_FULL, f"{address} has {waiting} messages waiting", "wait, then try again")


def actor_ended(address: str) -> Refused:
    return Refused(Code.GONE, f"{address} ended before it read the message")


def crashed(address: str, error: str) -> Refused:
    return Refused(Code.CRASHED, f"{address} failed: {error}")


def wrong_type(actor: str, message_type: str, accepted: str) -> Refused:
    return Refused(Code.WRONG_TYPE, f"{actor} does not take {message_type}", f"send {accepted}")


# -- delivery between processes


def foreign_sender(sender: str) -> Refused:
    return Refused(Code.CHANNEL, f"this channel may not send in the name of {sender}", "send in your own name")


def not_permitted(address: str, message_type: str) -> Refused:
    reason = f"{address} accepts no {message_type} over this channel"
    return Refused(Code.CHANNEL, reason, "send only permitted messages", message_type)


def unknown_address(address: str) -> Refused:
    return Refused(Code.UNKNOWN_ADDRESS, f"this process has no actor {address}")


def oversized(size_bytes: int) -> Refused:
    size, limit = str(size_bytes), str(MAX_MESSAGE_BYTES)
    return Refused(Code.OVERSIZED, f"the message has {size} bytes", f"send at most {limit} bytes", size, limit)


def malformed(actor: str, error: Exception, accepted: str) -> Refused:
    return Refused(Code.MALFORMED, f"{actor} cannot read the message: {error}", f"send {accepted}")


def malformed_reply(error: Exception) -> Refused:
    return Refused(Code.MALFORMED_REPLY, f"the answer cannot be read: {error}")


def no_answer(verb: str) -> Refused:
    return Refused(Code.NO_ANSWER, "no answer", verb=verb)


# -- approval


def not_approved(names: str, cause: str, variable: str, can_ask: bool) -> Refused:
    """Return the refusal of names that need an approval. ``variable`` can allow them without asking."""
    reason, allow = f"{names} needs an operator's approval: {cause}", f"name it in {variable}"
    remedy = f"pass approve= to the robot, or {allow}" if can_ask else f"{allow} on the robot's host"
    return Refused(Code.NOT_APPROVED, reason, remedy, names, variable)
