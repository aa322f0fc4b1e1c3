"""A stand-in for ur-rtde's receive interface. Its arm is running, in a normal safety mode, and does not
move."""

from __future__ import annotations

RUNNING, NORMAL = 7, 1


class RTDEReceiveInterface:
    def __init__(self, host: str, frequency: float | None = None) -> None:
        pass

    def getRobotMode(self) -> int:  # the SDK's names
        return RUNNING

    def getSafetyMode(self) -> int:
        return NORMAL

    def getActualQ(self) -> list[float]:
        return [0.0] * 6

    def getActualQd(self) -> list[float]:
        return [0.0] * 6

    def getActualTCPPose(self) -> list[float]:
        return [0.0] * 6

    def getActualTCPSpeed(self) -> list[float]:
        return [0.0] * 6

    def getActualTCPForce(self) -> list[float]:
        return [0.0] * 6

    def disconnect(self) -> None:
        pass
