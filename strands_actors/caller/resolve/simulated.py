"""The arguments of ``Robot(...)`` for simulations only: backend, model file, position, keyframe."""

from __future__ import annotations

import importlib.util
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from strands_actors.contract.loading import load
from strands_actors.drivers import MODEL, model_of
from strands_actors.simulation.scene import placement

BACKENDS = ("mujoco", "newton", "isaac")

EXPERIMENTAL = {
    "backend='isaac'": "nobody has seen it on Isaac Sim. It was tried with a stand-in for Isaac Sim's classes"
}
"""Options of simulations that are experimental, with the reason. It is like ``Driver.EXPERIMENTAL``."""

ISAAC = (
    "Isaac Sim is not here. It needs Python 3.11 and an RTX graphics card: "
    "pip install 'isaacsim[all,extscache]>=5,<6' --extra-index-url https://pypi.nvidia.com"
)

NEWTON = ("newton", "mujoco_warp")
"""Packages of the extra ``newton``."""

ONBOARD = "strands_actors.policies.onnx.policy:OnnxPolicy"
"""The class of a policy that keeps a simulated robot standing while it holds."""

HOME = "home"
"""The only keyframe of a built-in robot. It is the pose in which it begins anyway."""


@dataclass(frozen=True)
class Scene:
    """The keywords of ``Robot(...)`` for simulations, as the user gave them."""

    backend: str = "mujoco"
    urdf_path: str | os.PathLike[str] | None = None
    position: Any = None
    orientation: Any = None
    keyframe: str | int | None = None
    gated: bool = True
    onboard: str | os.PathLike[str] | None = None

    def simulation_keywords(self) -> dict[str, Any]:
        """Return the given keywords that only a simulation uses."""
        own = {
            name: getattr(self, name) for name in ("urdf_path", "position", "orientation", "keyframe", "onboard")
        }
        own["backend"] = self.alternative_backend or None
        own["gated"] = None if self.gated else False
        return {name: value for name, value in own.items() if value is not None}

    def model(self, robot: str) -> str | None:
        """Return the user's model file (MJCF or URDF) for this robot; None if the built-in model is simulated."""
        return os.fspath(self.urdf_path) if self.urdf_path is not None else model_of(robot)

    @property
    def alternative_backend(self) -> str:
        """Return the backend (the physics engine); empty for MuJoCo."""
        return "" if self.backend == BACKENDS[0] else self.backend

    @property
    def place(self) -> dict[str, Any] | None:
        """Return position and orientation of the base; None for those of the model.

        Raise ``ValueError`` if they are wrong.
        """
        try:
            return placement(self.position, self.orientation)
        except ValueError as wrong:
            raise ValueError(f"Robot: {wrong}") from None


def check_backend(backend: object) -> None:
    """Raise ``ValueError`` for an unknown backend, ``ImportError`` if its packages are missing."""
    if backend not in BACKENDS:
        raise ValueError(f"Robot: backend is {backend!r}. Use one of {', '.join(map(repr, BACKENDS))}")
    if backend == "isaac" and importlib.util.find_spec("isaacsim") is None:
        raise ImportError(f"Robot: backend 'isaac': {ISAAC}")
    if backend == "newton" and (lacking := [name for name in NEWTON if importlib.util.find_spec(name) is None]):
        raise ImportError(
            f"Robot: backend 'newton' needs {' and '.join(lacking)}: pip install 'strands-actors[newton]'"
        )


def read_own_model(robot: str, file: str, scene: Scene) -> tuple[type[Any], dict[str, Any], dict[str, Any]]:
    """Return the driver class for a model file, its options, and the options of the simulated robot. Raise
    ``ValueError`` for an unknown keyframe or a file that cannot be read.
    """
    driver_class = load(MODEL)
    options = driver_class.resolve(robot, {"model": file})
    twin: dict[str, Any] = {"model": os.path.abspath(os.path.expanduser(file))}
    if scene.keyframe is not None:
        keyframes: dict[str, list[float]] = options["keyframes"]
        names = list(keyframes)
        keyframe = scene.keyframe
        if isinstance(keyframe, int) and not isinstance(keyframe, bool) and 0 <= keyframe < len(names):
            keyframe = names[keyframe]
        if not isinstance(keyframe, str) or keyframe not in keyframes:
            raise ValueError(
                f"Robot: keyframe is {scene.keyframe!r}. "
                f"The model of {robot} has {', '.join(names) or 'no keyframes'}"
            )
        twin["home"] = keyframes[keyframe]
    if scene.onboard is not None:
        twin |= {"onboard": ONBOARD, "onboard_options": {"folder": _onboard_folder(scene.onboard)}}
    return driver_class, options, twin


def _onboard_folder(onboard: str | os.PathLike[str]) -> str:
    """Return the folder of the policy that keeps a simulated robot standing. Raise ``ValueError`` if it is none."""
    # This import reads manifests, which only a robot with such a policy has.
    from strands_actors.policies.folders import ONNX, read_folder

    folder = os.path.abspath(os.path.expanduser(onboard))
    if not os.path.isdir(folder) or read_folder(Path(folder)).provider != ONNX:
        raise ValueError(f"Robot: onboard is {str(onboard)!r}. Give the folder of an ONNX policy")
    return folder


def check_built_in(robot: str, scene: Scene) -> None:
    """Raise ``ValueError`` for a keyframe that a built-in robot does not have, or for a controller on board."""
    if scene.onboard is not None:
        raise ValueError(
            f"Robot: onboard is for a model of yours (urdf_path), and {robot} is built in. Leave it out"
        )
    if scene.keyframe not in (None, HOME, 0) or isinstance(scene.keyframe, bool):
        raise ValueError(f"Robot: keyframe is {scene.keyframe!r}. {robot} has only {HOME!r}, in which it begins")
