"""What happens in one run, as data: drawn from the seed, and made shorter when it fails."""

from __future__ import annotations

import random
from typing import NamedTuple

import msgspec

CALLER = "caller"
OPERATORS = ("operator", "second operator")
PROCESSES = ("caller", "root", "wire", "policy", "standby")

BOOT_S = 0.25
"""By then the link is up on a quiet machine, and the caller has energised the robot."""
ACTIVE_S = 1.5
"""How long faults and asks are drawn for, from then on."""


class Event(msgspec.Struct, frozen=True):
    """``who``: a process or who asks; ``value``: a duration in seconds, or a share; ``motor``: of
    the bus."""

    at_s: float
    kind: str
    who: str = ""
    value: float = 0.0
    motor: int = 0

    def __str__(self) -> str:
        parts = [f"{self.at_s:7.4f} s", self.kind, self.who]
        if self.motor:
            parts.append(f"motor {self.motor}")
        if self.value:
            parts.append(f"{self.value:.3f}")
        return " ".join(part for part in parts if part)


class Plan(msgspec.Struct, frozen=True):
    """``style``: what the caller does by itself: stream, oneshot, task or rest."""

    seed: int
    robot: str
    style: str
    events: tuple[Event, ...]


ASKS = {
    "stop": 4,
    "estop": 3,
    "resume": 6,
    "resume softly": 1,
    "oneshot": 4,
    "stream": 3,
    "acquire": 1,
    "release": 3,
    "status": 1,
    "start task": 3,
    "stop task": 3,
    "fence": 1,
    "cleanup": 2,
}
FAULTS = {
    "kill": 6,
    "freeze": 6,
    "lag": 2,
    "cut mesh": 1,
    "slow mesh": 1,
    "slow spawner": 2,
    "restart": 2,  # of the script, by systemd
    "attack": 2,  # by the policy process
}
BUS = {
    "lose replies": 4,
    "lose requests": 2,
    "mute": 5,
    "late": 1,
    "corrupt": 2,
    "twice": 1,
    "pull": 4,
    "unload": 2,
    "brown out": 1,
}
SESSION = {  # of a stream: nothing is lost or doubled, but held up
    "pull": 4,
    "hold requests": 2,
    "hold replies": 3,
    "stall": 4,
    "late": 1,
    "mute": 2,
    "garble": 2,
    "reset": 3,
    "brown out": 1,
}
NETWORK = {  # of datagrams
    "lose replies": 3,
    "lose requests": 2,
    "drop": 3,
    "late": 2,
    "twice": 1,
    "corrupt": 2,
    "pull": 3,
    "stall": 3,
    "brown out": 1,
}
CONDITIONS = {"low battery": 2}
SERVICE = {"slow service": 3, "out of reach": 3}
WIRE_FAULTS: dict[str, dict[str, int]] = {
    "so101": BUS,
    "xarm7": SESSION,
    "unitree_go2": {**NETWORK, **CONDITIONS},
    "fake_base": SERVICE,
    "fake_drone": {**SERVICE, **CONDITIONS},
    "fake_http": SERVICE,
}
"""By robot: what its wire does, and how often."""
AT_A_POINT = ("unload", "brown out", "reset")
"""What has no end."""
SHORT_S = (0.002, 0.02, 0.06, 0.15, 0.3, 0.7)


class Step(NamedTuple):
    """Part of a recipe; ``value``: between these."""

    kind: str
    who: tuple[str, ...]
    value: tuple[float, float] = (0.0, 0.0)


ASKERS = (CALLER, *OPERATORS)
Recipe = tuple[Step, Step, tuple[float, float]] | tuple[Step, Step, tuple[float, float], Step, tuple[float, float]]
RECIPES: tuple[Recipe, ...] = (
    (Step("lose replies", ("",)), Step("stop", ASKERS), (0.5, 1.2)),
    (Step("pull", ("",), (0.1, 0.5)), Step("mute", ("",)), (0.0, 0.1)),
    (Step("cleanup", (CALLER,)), Step("resume", OPERATORS), (-0.01, 0.09)),
    (Step("kill", (CALLER,)), Step("resume", OPERATORS), (-0.01, 0.09)),
    (Step("mute", ("",), (0.1, 1.5)), Step("release", (CALLER,)), (0.0, 0.7)),
    (Step("lose replies", ("",), (0.05, 0.5)), Step("freeze", (CALLER,)), (0.0, 0.4)),
    (Step("unload", ("",)), Step("oneshot", (CALLER,)), (0.05, 0.7)),
    (Step("unload", ("",)), Step("release", (CALLER,)), (0.0, 0.5)),
    (
        Step("kill", ("wire",)),
        Step("start task", (CALLER,), (0.3, 0.6)),
        (-0.02, 0.1),
        Step("stop task", ASKERS),
        (0.002, 0.03),
    ),
    (Step("slow spawner", (CALLER,), (0.9, 1.3)), Step("start task", (CALLER,), (0.5, 2.0)), (0.0, 0.01)),
    (Step("estop", ASKERS), Step("restart", (CALLER,)), (0.0, 0.3)),
    (Step("start task", (CALLER,), (0.3, 1.0)), Step("attack", ("policy",)), (0.02, 0.3)),
    (Step("attack", ("policy",)), Step("stop", ASKERS), (0.0, 0.4)),
    (
        Step("lag", ("root",), (0.005, 0.03)),
        Step("freeze", ("wire",)),
        (0.0, 0.05),
        Step("kill", ("root",)),
        (0.1, 0.15),
    ),
    (Step("kill", ("root", "wire", "standby")), Step("kill", ("root", "wire", "standby")), (0.0, 0.05)),
    (Step("freeze", ("root", "wire", "standby")), Step("kill", ("root", "wire", "standby")), (0.0, 0.05)),
    (Step("freeze", ("root", "wire")), Step("freeze", ("root", "wire")), (0.0, 0.05)),
    (Step("freeze", ("root",), (0.05, 0.3)), Step("stop", ASKERS), (0.0, 0.2)),
    (Step("freeze", (CALLER,)), Step("kill", ("root",)), (0.0, 0.15)),
)
_OF_ANY_WIRE = tuple(
    recipe for recipe in RECIPES if all(step.kind not in BUS for step in recipe if isinstance(step, Step))
)
SERVICE_RECIPES: tuple[Recipe, ...] = (
    (Step("out of reach", ("",), (0.05, 1.2)), Step("stop", ASKERS), (0.0, 0.6)),
    (Step("out of reach", ("",), (0.05, 1.2)), Step("kill", ("wire", "root", CALLER)), (0.0, 0.6)),
    (Step("slow service", ("",), (0.3, 1.5)), Step("stop", ASKERS), (0.0, 0.6)),
    (Step("slow service", ("",), (0.3, 1.5)), Step("freeze", ("wire", "root", CALLER)), (0.0, 0.6)),
    (Step("stop", ASKERS), Step("resume", ASKERS), (0.0, 0.4)),
    (Step("kill", ("wire", "standby")), Step("resume", ASKERS), (0.0, 0.7)),
    *_OF_ANY_WIRE,
)
SESSION_RECIPES: tuple[Recipe, ...] = (
    (Step("hold replies", ("",), (0.3, 1.2)), Step("stop", ASKERS), (0.1, 1.2)),
    (Step("pull", ("",), (0.1, 0.7)), Step("stop", ASKERS), (0.0, 0.9)),
    (Step("pull", ("",), (0.1, 0.7)), Step("resume", ASKERS), (0.0, 0.9)),
    (Step("stall", ("",), (0.02, 1.0)), Step("stop", ASKERS), (0.0, 0.6)),
    (Step("stall", ("",), (0.02, 1.0)), Step("release", (CALLER,)), (0.0, 0.6)),
    (Step("stall", ("",), (0.02, 1.0)), Step("kill", ("wire", "root", CALLER)), (0.0, 0.6)),
    (Step("resume", ASKERS), Step("stall", ("",), (0.02, 1.0)), (0.0, 0.02)),
    (Step("reset", ("",)), Step("kill", ("wire", "root")), (0.0, 0.2)),
    (Step("reset", ("",)), Step("stop", ASKERS), (0.0, 0.3)),
    (Step("mute", ("",), (0.1, 1.0)), Step("release", (CALLER,)), (0.0, 0.6)),
    *_OF_ANY_WIRE,
)
NETWORK_RECIPES: tuple[Recipe, ...] = (
    (Step("lose replies", ("",), (0.1, 1.2)), Step("stop", ASKERS), (0.0, 1.2)),
    (Step("pull", ("",), (0.05, 0.7)), Step("stop", ASKERS), (0.0, 0.9)),
    (Step("pull", ("",), (0.05, 0.7)), Step("kill", ("wire", "root", CALLER)), (0.0, 0.7)),
    (Step("stall", ("",), (0.02, 1.0)), Step("stop", ASKERS), (0.0, 0.6)),
    (Step("stall", ("",), (0.02, 1.0)), Step("kill", ("wire", "root", CALLER)), (0.0, 0.6)),
    (Step("late", ("",), (0.1, 0.7)), Step("kill", ("wire", CALLER)), (0.0, 0.5)),
    (Step("drop", ("",), (0.1, 0.7)), Step("release", (CALLER,)), (0.0, 0.5)),
    (Step("brown out", ("",)), Step("stop", ASKERS), (0.0, 0.5)),
    *_OF_ANY_WIRE,
)
RECIPES_OF = {"so101": RECIPES, "xarm7": SESSION_RECIPES, "unitree_go2": NETWORK_RECIPES}
"""By robot; of the others: those of services. Things that are dangerous beside each other, and how
many seconds each comes after the one before."""


def plan_of(seed: int, robot: str) -> Plan:
    """Draw a plan. Half of them have one fault or none, since what holds of one is promised
    sharply."""
    rng = random.Random(f"plan {seed} {robot}")
    events = [_ask(rng) for _ in range(rng.choice((0, 1, 2, 3, 5)))]
    events += [_fault(rng) for _ in range(rng.choice((0, 1, 1, 1, 2)))]
    events += [_of_the_wire(rng, robot) for _ in range(rng.choice((0, 0, 1, 1, 2)))]
    if rng.random() < 0.5:
        events = events[: rng.randrange(3)] + _recipe(rng, robot)
    elif events and rng.random() < 0.6:  # what is dangerous lies close together
        at_s = rng.choice(events).at_s
        near = _ask(rng) if rng.random() < 0.6 else _fault(rng)
        events.append(msgspec.structs.replace(near, at_s=round(max(0.0, at_s + rng.gauss(0.012, 0.02)), 5)))
    style = rng.choice(("stream", "stream", "oneshot", "task", "rest"))
    return Plan(seed, robot, style, tuple(sorted(events, key=lambda event: event.at_s)))


def _recipe(rng: random.Random, robot: str) -> list[Event]:
    recipe = rng.choice(RECIPES_OF.get(robot, SERVICE_RECIPES))
    first, second, gap_s = recipe[0], recipe[1], recipe[2]
    at_s = BOOT_S + 0.9 * rng.random()
    steps = [(first, at_s), (second, at_s := max(0.0, at_s + rng.uniform(*gap_s)))]
    motor = rng.randrange(1, 7)
    if len(recipe) == 5:
        steps.append((recipe[3], at_s + rng.uniform(*recipe[4])))
    return [
        Event(round(t_s, 5), step.kind, rng.choice(step.who), round(rng.uniform(*step.value), 4), motor)
        for step, t_s in steps
    ]


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
