"""Find the tool of an arm in a user's model: a site with a usual name, or the last link of its chain of joints."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

from strands_actors.drivers.common.physics.lean_mujoco import mujoco

from .reading import read_model

SITES = (
    "tcp", "tool", "tool0", "attachment_site", "gripperframe", "pinch", "pinch_site", "grasp_site", "ee_site",
    "end_effector", "ee",
)  # fmt: skip
"""Usual names of the site of a tool, in MuJoCo Menagerie and elsewhere. The first one that exists counts."""
LEAST_JOINTS = 3
"""A tool with fewer joints has no pose worth a search."""


class Tool(NamedTuple):
    """The tool of an arm.

    Attributes:
        site: The site that is the tool; empty if it is ``link``.
        link: The body that is the tool, or that carries the site.
        joints: The axes that move the tool, from the base on.
    """

    site: str
    link: str
    joints: tuple[str, ...]


def tool_of(model: Any, axes: Sequence[str]) -> Tool | None:
    """Return the tool of a compiled model; None if it has no arm, or a base that moves freely.

    Args:
        model: The compiled model.
        axes: Names of the joints that are driven.
    """
    site = next((name for name in SITES if _has_site(model, name)), "")
    body = int(model.site(site).bodyid[0]) if site else _last_of_chain(model)
    joints: list[str] = []
    link = body
    while link > 0:
        first, count = int(model.body_jntadr[link]), int(model.body_jntnum[link])
        for joint in range(first + count - 1, first - 1, -1):
            name = model.joint(joint).name
            if name not in axes:
                return None
            joints.append(name)
        link = int(model.body_parentid[link])
    if len(joints) < LEAST_JOINTS:
        return None
    return Tool(site, model.body(body).name, tuple(reversed(joints)))


def build(table: Any) -> Any:
    """Return the model of the file ``table["model"]`` as an ``MjSpec``."""
    return read_model(table["model"]).spec


def _has_site(model: Any, name: str) -> bool:
    return bool(mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, name) >= 0)


def _last_of_chain(model: Any) -> int:
    """Return the last body before the joints branch, as they do at the fingers of a gripper."""
    carries = {0}
    for joint in range(model.njnt):
        body = int(model.jnt_bodyid[joint])
        while body:
            carries.add(body)
            body = int(model.body_parentid[body])
    link = 0
    while True:
        children = [body for body in sorted(carries) if body and int(model.body_parentid[body]) == link]
        if len(children) != 1:
            return link
        link = children[0]
