"""The arm behind the twin: its model, and the arm as a simulation while no client commands it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from strands_actors.drivers.common.jointed_body import JointedBody
from strands_actors.drivers.common.simulation_control.body import Hand
from strands_actors.drivers.kuka.robots import TABLES, Arm

if TYPE_CHECKING:
    from .controller import Controller


def model_table(arm: Arm) -> Mapping[str, Any]:
    """Return the arm as ``drivers/common/model_rows`` takes it: range, effort and speed come from the joints."""
    table = TABLES.table(arm.name)
    joints = {joint.key: joint for joint in arm.joints}
    rows = []
    for line in table["links"].splitlines():
        if not line.strip():
            continue
        body, parent, key, axis, xyz, rot, kg, com, geom = line.split()
        joint = joints[key]
        limits = f"{-joint.reach_rad},{joint.reach_rad} {joint.effort_nm} {joint.speed_rad_s}"
        rows.append(f"{body} {parent} {key} {axis} {xyz} {rot} {limits} {kg} {com} {geom}")
    return {**table, "joints": [{"key": key} for key in arm.axes], "model_rows": "\n".join(rows)}


class KukaBody(JointedBody):
    """The controller keeps its arm energised whoever moves it: nothing here makes it limp."""

    def __init__(self, controller: Controller) -> None:
        super().__init__(controller.plant, lambda: controller.plant.catch_up(controller.now_s()))
        self._controller = controller

    @property
    def _hand(self) -> Hand:
        if self._controller.is_commanded:
            return Hand.WIRE
        return Hand.SIM if self._controller.simulated else Hand.NONE

    @property
    def hands(self) -> Sequence[Hand]:
        return [self._hand] * len(self.axes)

    def take(self, on: bool) -> None:
        if self._hand is (Hand.NONE if on else Hand.SIM):
            self._controller.stand()
            self._controller.simulated = on

    def aim(self, values: Sequence[float]) -> None:
        if self._hand is Hand.SIM:
            self._controller.aim(values)

    def hold(self) -> None:
        if self._hand is Hand.SIM:
            self._controller.stand()

    def reset(self) -> None:
        super().reset()
        self._controller.wake_up()
