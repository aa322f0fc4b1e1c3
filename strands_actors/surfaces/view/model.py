"""The robot's model in 3-D, for displays.

The twin of the robot's type has the model, built from the robot's table. The twin runs for a second to hand over a
copy, in a process beside the robot's. After that the frames are computed here.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Protocol

from strands_actors.caller.processes.twin_process import TwinProcess, TwinProcessDown
from strands_actors.contract.driver import Driver
from strands_actors.contract.loading import load
from strands_actors.drivers import MODEL, get_native_driver_class

WORLD = "world"
"""Name of the frame in which the robot stands."""

_DRAWN_MODEL = "strands_actors.drivers.common.simulation_control.drawn:drawn_model"


class NoModel(Exception):
    """There is no model of the robot. The text has the reason."""


class Mesh(Protocol):
    """A surface of one body, in the frame of the body, in metres. ``points`` and ``faces`` are arrays of numpy:
    ``points`` has a row for each corner, ``faces`` three indices for each triangle. ``rgba`` is from 0 to 1."""

    @property
    def body(self) -> str: ...
    @property
    def points(self) -> Any: ...
    @property
    def faces(self) -> Any: ...
    @property
    def rgba(self) -> tuple[float, float, float, float]: ...


class Frame(Protocol):
    """The frame of a body in that of its parent: metres, and a quaternion w, x, y, z."""

    @property
    def name(self) -> str: ...
    @property
    def parent(self) -> str: ...
    @property
    def xyz(self) -> tuple[float, float, float]: ...
    @property
    def quat(self) -> tuple[float, float, float, float]: ...


class Joint(Protocol):
    """A joint that turns or slides its body by ``position - zero``, in the frame of the body: radians or metres."""

    @property
    def name(self) -> str: ...
    @property
    def slides(self) -> bool: ...
    @property
    def axis(self) -> tuple[float, float, float]: ...
    @property
    def anchor(self) -> tuple[float, float, float]: ...
    @property
    def zero(self) -> float: ...
    @property
    def start(self) -> float: ...


class Body(Protocol):
    """A body: its frame while its joints are at ``zero``, and the joints that move it."""

    @property
    def frame(self) -> Frame: ...
    @property
    def joints(self) -> Sequence[Joint]: ...


class RobotModel(Protocol):
    """The model of a robot."""

    def meshes(self) -> Iterable[Mesh]:
        """Return everything that is drawn of the robot."""
        ...

    def bodies(self) -> Sequence[Body]:
        """Return the bodies and joints, for a display that computes the frames itself."""
        ...

    def frames(self, positions: Mapping[str, float]) -> Sequence[Frame]:
        """Return the frame of each body. ``positions`` has joints in radians or metres."""
        ...


def positions_of(measured: Mapping[str, float], units: Mapping[str, tuple[float, float]]) -> dict[str, float]:
    """Return positions in radians or metres, from those in the robot's units.

    Args:
        measured: Position by axis.
        units: (zero, scale) by axis, as ``Driver.model_units`` has them. Axes without a scale are left out.
    """
    return {
        axis: (value - units[axis][0]) / units[axis][1]
        for axis, value in measured.items()
        if axis in units and units[axis][1]
    }


async def read_model(robot_type: str, file: str = "") -> RobotModel:
    """Return the model of a robot's type, from its twin. It takes a second or more.

    Args:
        robot_type: The type of the robot, such as ``so101``.
        file: A model file of the user (MJCF or URDF), for a robot that is simulated from it.

    Raises:
        NoModel: The type is not known here, or its twin cannot be started.
    """
    driver_class: type[Driver] | None = load(MODEL) if file else get_native_driver_class(robot_type)
    served = getattr(driver_class, "TWIN", None)
    if served is None:
        raise NoModel(f"{robot_type} has no model here. Give the file of its model: --model-file FILE")
    twin = TwinProcess(served, robot_type, has_control=True, options={"model": file} if file else None)
    try:
        await twin.start()
        model: RobotModel = await load(_DRAWN_MODEL)(twin.control)
    except (TwinProcessDown, RuntimeError) as failure:
        raise NoModel(f"{robot_type}: its model cannot be read: {failure}") from failure
    finally:
        await twin.close()
    return model
