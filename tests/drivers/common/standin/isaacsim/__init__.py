"""A stand-in for Isaac Sim 5: the names that are called, and the order in which the calls are allowed.

Its physics is a first-order lag toward each target. A joint without stiffness turns with its torque.
"""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from typing import Any

calls: list[tuple[str, Any]] = []
running: list[Any] = []
imported: dict[str, list[str]] = {}
"""Joints by the path of the prim to which a file was imported, in the importer's order and not the file's."""


class SimulationApp:
    def __init__(self, launch_config: dict[str, Any]) -> None:
        assert not running, "only one app can run in a process"
        calls.append(("app", launch_config))
        running.append(self)


def take(path: str, file: str) -> None:
    joints = [joint.attrib["name"] for joint in ElementTree.parse(file).iter("joint") if "name" in joint.attrib]
    imported[path] = sorted(set(joints), reverse=True)
