"""Write the rows of a hand with two fingers that slide (``link_rows``). Pure."""

from __future__ import annotations


def parallel_rows(hand: str, flange: str, *, body: str, place: str, finger: str, travel_m: float) -> str:
    """Return the rows of a hand with two fingers that slide along its axis y. An open hand has its fingers apart.

    Args:
        hand: Name of the link of the hand's body.
        flange: The link of the arm that carries the hand.
        body: The columns of the hand's body from ``xyz`` on.
        place: Where the closed fingers are in the frame of the hand, in metres.
        finger: Mass of a finger, and its shape: a box with its half sizes, which begins in the middle of the hand.
        travel_m: The way of each finger.
    """
    kg, box = finger.split()
    half_m = box.split(",")[1]
    rows = [f"{hand} {flange} - - {body}"]
    rows += [
        f"{side}_finger {hand} {side}_finger_joint {sign}sy {place} 0 0,{travel_m} - - "
        f"{kg} - {box}@0,{sign}{half_m},0"
        for side, sign in (("left", ""), ("right", "-"))
    ]
    return "\n".join(rows)


__all__ = ["parallel_rows"]
