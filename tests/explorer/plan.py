"""Describe the events of one run as data.

A plan is drawn from a seed. When its run fails, the plan is made shorter.
"""

from __future__ import annotations

import random

import msgspec

from .kinds import (
    ASKS,
    AT_A_POINT,
    CALLER,
    EXHAUSTED,
    EXHAUSTION,
    FAULTS,
    MOMENTS,
    MOST_STEPS,
    OPERATORS,
    PROCESSES,
    SHORT_S,
    WIRE_FAULTS,
)
from .recipes import groups_of

BOOT_S = 0.25
"""By then the link is up on a quiet machine, and the caller has energised the robot."""
ACTIVE_S = 1.5
"""Faults and requests are drawn for this time after ``BOOT_S``."""


class Event(msgspec.Struct, frozen=True):
    """A request or a fault.

    Attributes:
        who: The process that is hit, or the sender of the request.
        value: A duration in seconds, or a share.
        motor: The motor on the bus.
        after: A type of message. The event waits until ``who`` next receives a message of this
            type, and then for ``steps`` more steps of its tasks. So the event can fall between any
            two awaits of the handling of that message.
    """

    at_s: float
    kind: str
    who: str = ""
    value: float = 0.0
    motor: int = 0
    after: str = ""
    steps: int = 0

    def __str__(self) -> str:
        parts = [f"{self.at_s:7.4f} s", self.kind, self.who]
        if self.motor:
            parts.append(f"motor {self.motor}")
        if self.value:
            parts.append(f"{self.value:.3f}")
        if self.after:
            parts.append(f"{self.steps} steps after {self.after}")
        return " ".join(part for part in parts if part)


class Plan(msgspec.Struct, frozen=True):
    """The events of one run.

    Attributes:
        style: The activity of the caller between events: stream, oneshot, task or rest.
    """

    seed: int
    robot: str
    style: str
    events: tuple[Event, ...]


def plan_of(seed: int, robot: str) -> Plan:
    """Draw a plan. Half of the plans have at most one fault, because the bounds are promised for a
    single fault."""
    rng = random.Random(f"plan {seed} {robot}")
    events = [_ask(rng) for _ in range(rng.choice((0, 1, 2, 3, 5)))]
    events += [_fault(rng) for _ in range(rng.choice((0, 1, 1, 1, 2)))]
    events += [_of_the_wire(rng, robot) for _ in range(rng.choice((0, 0, 1, 1, 2)))]
    if rng.random() < 0.5:
        events = events[: rng.randrange(3)] + _recipe(rng, robot)
    # Events that lie close together are the most dangerous.
    elif events and rng.random() < 0.6:
        at_s = rng.choice(events).at_s
        near = _ask(rng) if rng.random() < 0.6 else _fault(rng)
        events.append(msgspec.structs.replace(near, at_s=round(max(0.0, at_s + rng.gauss(0.012, 0.02)), 5)))
    style = rng.choice(("stream", "stream", "oneshot", "task", "rest"))
    return Plan(seed, robot, style, tuple(sorted(events, key=lambda event: event.at_s)))


def _recipe(rng: random.Random, robot: str) -> list[Event]:
    recipe = rng.choice(rng.choice(groups_of(robot)))
    first, second, gap_s = recipe[0], recipe[1], recipe[2]
    at_s = BOOT_S + 0.9 * rng.random()
    if rng.random() < 0.15:  # while the tree starts and the robot is armed for the first time
        at_s = 0.02 + 1.4 * BOOT_S * rng.random()
    steps = [(first, at_s), (second, at_s := max(0.0, at_s + rng.uniform(*gap_s)))]
    motor = rng.randrange(1, 7)
    if len(recipe) == 5:
        steps.append((recipe[3], at_s + rng.uniform(*recipe[4])))
    return [
        Event(
            round(t_s, 5),
            step.kind,
            rng.choice(step.who),
            round(rng.uniform(*step.value), 4),
            motor,
            step.after,
            _steps(rng) if step.after else 0,
        )
        for step, t_s in steps
    ]


def _steps(rng: random.Random) -> int:
    """Draw a number of steps. Small numbers are likely, because most messages are handled in few."""
    return round(2 ** rng.uniform(0, MOST_STEPS))


def _when_s(rng: random.Random) -> float:
    if rng.random() < 0.1:
        return round(BOOT_S * rng.random(), 5)  # while it starts
    return round(BOOT_S + ACTIVE_S * rng.random(), 5)


def _pick(rng: random.Random, weights: dict[str, int]) -> str:
    return rng.choices(list(weights), list(weights.values()))[0]


def _ask(rng: random.Random) -> Event:
    kind = _pick(rng, ASKS)
    who = CALLER if kind in ("cleanup", "acquire") or rng.random() < 0.5 else rng.choice(OPERATORS)
    if kind == "start task":
        who = CALLER
    return Event(_when_s(rng), kind, who, round(0.1 + 0.6 * rng.random(), 4))


def _fault(rng: random.Random) -> Event:
    kind = _pick(rng, FAULTS)
    who = rng.choice(PROCESSES)
    value = round(rng.choice(SHORT_S) * (0.5 + rng.random()), 4)
    if kind == "freeze" and rng.random() < 0.4:
        value = 0.0  # for good
    if kind in EXHAUSTION:
        who = rng.choice(EXHAUSTED)
    if kind in ("kill", "freeze") and who in MOMENTS and rng.random() < 0.25:
        return Event(_when_s(rng), kind, who, value, 0, rng.choice(MOMENTS[who]), _steps(rng))
    if kind == "lag":
        value = round(0.05 * rng.random(), 4)
    if kind == "slow spawner":
        value = round(4.0 * rng.random(), 4)
    if kind in ("restart", "attack"):
        who, value = {"restart": CALLER, "attack": "policy"}[kind], 0.0
    return Event(_when_s(rng), kind, who, value)


def _of_the_wire(rng: random.Random, robot: str) -> Event:
    kind = _pick(rng, WIRE_FAULTS[robot])
    value = round(rng.choice(SHORT_S) * (0.5 + 2 * rng.random()), 4)
    if rng.random() < 0.3 and kind not in AT_A_POINT:
        value = 0.0  # until the end
    return Event(_when_s(rng), kind, "", value, rng.randrange(1, 7))
