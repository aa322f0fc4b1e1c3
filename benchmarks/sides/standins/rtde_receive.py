"""In place of ur-rtde's receive interface: an arm that is running, safe, and stands where it is."""

from __future__ import annotations

RUNNING, NORMAL = 7, 1


class RTDEReceiveInterface:
    def __init__(self, host: str, frequency: float | None = None) -> None:
        pass

    def getRobotMode(self) -> int:  # noqa: N802  # the SDK's names
        return RUNNING

    def getSafetyMode(self) -> int:  # noqa: N802
        return NORMAL

    def getActualQ(self) -> list[float]:  # noqa: N802
        return [0.0] * 6

    def getActualQd(self) -> list[float]:  # noqa: N802
        return [0.0] * 6

    def getActualTCPPose(self) -> list[float]:  # noqa: N802
        return [0.0] * 6

    def getActualTCPSpeed(self) -> list[float]:  # noqa: N802
        return [0.0] * 6

    def getActualTCPForce(self) -> list[float]:  # noqa: N802
        return [0.0] * 6

    def disconnect(self) -> None:
        pass
