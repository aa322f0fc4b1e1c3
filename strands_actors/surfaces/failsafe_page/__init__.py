"""Make the interactive page of the failsafe state machine, on which a reader tries out events.

    python -m strands_actors.surfaces.failsafe_page > docs/failsafe.html

The page is a single file. This module computes the result of each event in each mode with ``failsafe.step``.
The page has these results as a table, and no logic of the state machine.
"""

from __future__ import annotations

import json
from importlib import resources
from typing import Any

from strands_actors.supervisors.gate import failsafe
from strands_actors.supervisors.gate.failsafe import Action, Event, Mode, State

ESTOP = "e-stop"
"""A stop that locks. The page shows it as a separate event."""
READER = "you"
"""The name of the reader, who gives the e-stop."""

MODES: dict[Mode, str] = {
    Mode.DOWN: "No link to the robot. Nothing of ours is energised.",
    Mode.LOST: "No link, and it went while the robot was energised, or before the safe state was confirmed.",
    Mode.DISARMED: "The link is up and the robot stands on the safe state of a stop. It waits for a resume.",
    Mode.ARMING: "The motors are being energised at the measured position: nothing jumps.",
    Mode.ARMED: "Energised. Setpoints that pass the gate are written.",
    Mode.HOLDING: "Energised at the measured position. The last writer is gone or late; a fresh command goes on.",
    Mode.STOPPING: "The safe frames are out, and each motor is being read back.",
    Mode.UNCONFIRMED: "A motor did not confirm the safe state. The report names it.",
    Mode.FAILED: "The restart budget is spent. The robot stays safe; only a new tree helps.",
    Mode.ENDING: "The tree ends. The safe frames are out, not yet confirmed. Nobody is obeyed any more.",
    Mode.ENDED: "The tree ends, and the robot is safe. Nobody is obeyed any more.",
}

EVENTS: dict[str, str] = {
    Event.LINK_UP: "the wire was opened and answers",
    Event.RESUME: "somebody calls resume()",
    Event.ARM_DONE: "every motor is energised",
    Event.ARM_FAILED: "a motor could not be energised",
    Event.SETPOINT: "a command has passed the gate",
    Event.HOLD: "the setpoint expired, the lease lapsed, or the policy ended",
    Event.STOP: "stop(), a wire or a link that broke, or any other reason",
    ESTOP: "a stop that also locks, until a resume",
    Event.END: "cleanup(), the end of the caller, the loss of the root",
    Event.SAFE_CONFIRMED: "every motor was read back safe",
    Event.SAFE_UNCONFIRMED: "a motor was silent, or not safe",
    Event.LINK_LOST: "the cable, the socket or the bus is gone",
}

ACTIONS: dict[Action, str] = {
    Action.NONE: "nothing to do",
    Action.ARM: "energise at the measured position",
    Action.MAKE_SAFE: "write the safe frames to every motor",
}

STORIES: dict[str, tuple[str, ...]] = {
    "connect and move": (Event.LINK_UP, Event.RESUME, Event.ARM_DONE, Event.SETPOINT),
    "the policy dies, a new command goes on": (
        Event.LINK_UP, Event.RESUME, Event.ARM_DONE, Event.SETPOINT, Event.HOLD, Event.SETPOINT,
    ),
    "stop while moving": (
        Event.LINK_UP, Event.RESUME, Event.ARM_DONE, Event.SETPOINT, Event.STOP, Event.SAFE_CONFIRMED,
    ),
    "e-stop, then resume": (
        Event.LINK_UP, Event.RESUME, Event.ARM_DONE, ESTOP, Event.SAFE_CONFIRMED, Event.SETPOINT, Event.RESUME,
        Event.ARM_DONE,
    ),
    "the cable is pulled while moving": (
        Event.LINK_UP, Event.RESUME, Event.ARM_DONE, Event.SETPOINT, Event.LINK_LOST, Event.LINK_UP,
        Event.SAFE_CONFIRMED,
    ),
    "stopped during bring-up": (
        Event.LINK_UP, Event.RESUME, Event.STOP, Event.ARM_DONE, Event.SAFE_CONFIRMED,
    ),
    "the script ends, a resume comes too late": (
        Event.LINK_UP, Event.RESUME, Event.ARM_DONE, Event.SETPOINT, Event.END, Event.RESUME, Event.SAFE_CONFIRMED,
        Event.RESUME,
    ),
}  # fmt: skip


def data() -> dict[str, Any]:
    """Return the state machine as plain data.

    For every mode and event the data has the next mode, whether the epoch rises (the number that makes older
    setpoints invalid), the action, and the effect on the lock (``keeps``, ``locks`` or ``lifts``).
    """
    start = State()
    return {
        "start": {"mode": start.mode, "epoch": start.epoch, "locked_by": start.locked_by},
        "reader": READER,
        "modes": {
            mode: {
                "text": text,
                "writable": mode in failsafe.WRITABLE,
                "linked": mode in failsafe.LINKED,
                "energised": mode in failsafe.WRITABLE or mode is Mode.ARMING,
            }
            for mode, text in MODES.items()
        },
        "events": EVENTS,
        "actions": ACTIONS,
        "table": {mode: {event: _cell(mode, event) for event in EVENTS} for mode in MODES},
        "stories": STORIES,
    }


def _cell(mode: Mode, event: str) -> dict[str, Any]:
    lock = READER if event == ESTOP else ""
    plain = Event.STOP if event == ESTOP else Event(event)
    free, action = failsafe.step(State(mode, 0, ""), plain, lock)
    locked, _ = failsafe.step(State(mode, 0, "somebody"), plain, lock)
    return {
        "mode": free.mode,
        "raises": free.epoch,
        "action": action,
        "lock": "locks" if free.locked_by else "keeps" if locked.locked_by else "lifts",
        "acts": (mode, plain) in failsafe.TRANSITIONS,
    }


def page() -> str:
    template = resources.files(__package__).joinpath("template.html").read_text(encoding="utf-8")
    # In HTML, "</" would end the script element. In JSON, "<\\/" is the same string.
    return template.replace("{{DATA}}", json.dumps(data(), indent=1).replace("</", "<\\/"))
