"""A fake of ur-rtde's receive interface. Its arm runs, in a normal safety mode, and does not move."""

from __future__ import annotations

RUNNING, NORMAL = 7, 1


class RTDEReceiveInterface:
    def __init__(self, host: str, frequency: float | None = None) -> None:
        pass

    # The name of the method is the one in the SDK.
    def getRobotMode(self) -> int:
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
