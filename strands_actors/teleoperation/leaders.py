"""Several leaders as one: each leads one part of a robot that is made of parts."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from strands_actors.contract.driver import Driver
from strands_actors.contract.shown import shown

from .machine import Kind
from .teleoperator import Teleoperator


class Leaders(Teleoperator):
    """The leaders of all parts of one robot. ``arm.teleoperate({"left": ..., "right": ...})`` makes it.

    All leaders are read together. The robot moves only while every leader is read, and the gripper of the first
    leader is the dead-man if it is an arm.

    Args:
        leaders: The leader of each part, by the part's name.

    Raises:
        TypeError: It is not a mapping of leaders.
        ValueError: A leader is an operator's input, or one repeats changes and another one poses.
    """

    def __init__(self, leaders: Mapping[str, Teleoperator]) -> None:
        if not leaders or not all(isinstance(leader, Teleoperator) for leader in leaders.values()):
            raise TypeError(f"the leader is {shown(leaders)}. Give a Teleoperator for each part of the robot")
        kinds = {leader.kind for leader in leaders.values()}
        if Kind.JOG in kinds or len(kinds) > 1:
            raise ValueError(
                "the leaders differ in kind, or one is an operator's input. Give leader arms or objects"
            )
        self._leaders = dict(leaders)
        self._driver = None
        self._twin = None
        self._address_file: Path | None = None
        self.name = " and ".join(f"{leader.name} ({part})" for part, leader in leaders.items())
        self.kind = next(iter(kinds))

    @property
    def is_arm(self) -> bool:
        return next(iter(self._leaders.values())).is_arm

    @property
    def caveats(self) -> tuple[str, ...]:
        return tuple(f"{part}: {caveat}" for part, leader in self._leaders.items() for caveat in leader.caveats)

    def check(self, driver: Driver) -> None:
        """Raise ``ValueError`` if the leaders are not those of the robot's parts."""
        parts = ", ".join(driver.part_prefixes) or "none"
        if set(self._leaders) != set(driver.part_prefixes):
            raise ValueError(
                f"there are leaders for {', '.join(self._leaders)}. The parts of the robot are {parts}"
            )

    async def source(self) -> dict[str, Any]:
        sources = {part: await leader.source() for part, leader in self._leaders.items()}
        first, source = next(iter(sources.items()))
        gripper = {"gripper": [first, *source["gripper"]]} if "gripper" in source else {}
        return {"type": "leaders", "parts": sources, **gripper}

    def cleanup(self) -> None:
        for leader in self._leaders.values():
            leader.cleanup()


def prefixed(source: dict[str, Any], driver: Driver) -> dict[str, Any]:
    """Return the description of the leaders with the names that the axes of a part have in the whole robot."""
    prefixes = driver.part_prefixes
    made: dict[str, Any] = {
        "type": "leaders",
        "parts": {prefixes[part]: own for part, own in source["parts"].items()},
    }
    if "gripper" in source:
        part, key, *limits = source["gripper"]
        made["gripper"] = [prefixes[part] + key, *limits]
    return made
