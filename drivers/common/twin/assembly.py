"""How the servos of one simulated arm were built in, where they differ from the robot's table.

The text ``3:turned=14.4,5:ratio=1.5,2:id=4,4:id=2,6:firmware=3.9`` names servos by the id that they have in the
table. ``turned`` is the angle in degrees by which the horn was mounted further, ``ratio`` the number of turns of
the servo for one of the joint, ``id`` and ``firmware`` what the servo answers.
"""

from __future__ import annotations

import math

import msgspec

KEYS = ("turned", "ratio", "id", "firmware")


class BuiltIn(msgspec.Struct, frozen=True):
    """How one servo was built in.

    Attributes:
        turned_rad: The servo's angle when the joint is at 0.
        ratio: Turns of the servo for one turn of the joint.
        id: The id of the servo; None for that of the table.
        firmware: Its firmware version, such as ``3.9``; None for the usual one.
    """

    turned_rad: float = 0.0
    ratio: float = 1.0
    id: int | None = None
    firmware: str | None = None

    def shaft_rad(self, joint_rad: float) -> float:
        """Return the angle of the servo's shaft."""
        return joint_rad * self.ratio + self.turned_rad

    def joint_rad(self, shaft_rad: float) -> float:
        """Return the angle of the joint."""
        return (shaft_rad - self.turned_rad) / self.ratio


AS_IN_TABLE = BuiltIn()


def parse_assembly(text: str | None, ids: frozenset[int]) -> dict[int, BuiltIn]:
    """Return how servos were built in, by the id that they have in the table.

    Args:
        text: As in the docstring of this module; None for an arm as in its table.
        ids: The ids of the robot's servos.

    Raises:
        ValueError: The text is wrong.
    """
    settings: dict[int, dict[str, str]] = {}
    for part in (text or "").split(",") if text else ():
        servo, colon, setting = part.partition(":")
        key, equals, value = setting.partition("=")
        if not (colon and equals and servo.isdecimal() and int(servo) in ids and key in KEYS):
            raise ValueError(
                f"assembly: {part!r} is not ID:KEY=VALUE. Use the ids {', '.join(map(str, sorted(ids)))} and the "
                f"keys {', '.join(KEYS)}"
            )
        settings.setdefault(int(servo), {})[key] = value
    try:
        return {servo: _built_in(values) for servo, values in settings.items()}
    except ValueError as error:
        raise ValueError(f"assembly: {error}. Give numbers, such as 3:turned=14.4") from None


def _built_in(values: dict[str, str]) -> BuiltIn:
    return BuiltIn(
        turned_rad=math.radians(float(values.get("turned", 0.0))),
        ratio=float(values.get("ratio", 1.0)),
        id=int(values["id"]) if "id" in values else None,
        firmware=values.get("firmware"),
    )
