"""The provider ``lerobot_local``: a checkpoint of lerobot, run in the policy's own process.

A checkpoint is a folder as lerobot >= 0.4 saves one: configuration, weights, and the two processors
that normalise what goes in and out. It is given positions and the instruction; one that also wants
images, or a state of another size, is refused. Nothing is downloaded here.

What its numbers mean no checkpoint says: it depends on how its data were recorded (``use_degrees``
of lerobot's arms, whose default differs by arm and version). So ``units`` has no default:

``degrees``      (or whatever the driver's own unit is) the numbers are the driver's own. They mean the same only
                 under the calibration of the arm that recorded: it says where zero is.
``normalized``   lerobot's other scale: -100..100 over each joint's calibrated range, the gripper 0..100. Needs the
                 driver to have a calibration.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

STATE = "observation.state"
FILES = ("config.json", "model.safetensors", "policy_preprocessor.json", "policy_postprocessor.json")
GRIPPER = "gripper"
"""lerobot's name for the one motor that it counts from 0 to 100, whatever the others are in."""


class Scale:
    """Between the driver's units and -100..100 (the gripper: 0..100) of lerobot, which bounds both.
    ``travel``: each axis' calibrated range in the driver's units."""

    def __init__(self, axes: Sequence[str], travel: Mapping[str, Sequence[float]]) -> None:
        self._ranges = [(0.0 if axis == GRIPPER else -100.0, *travel[axis]) for axis in axes]

    def to_lerobot(self, values: Sequence[float]) -> list[float]:
        rows = zip(values, self._ranges, strict=True)
        return [_onto(value, low, high, least, 100.0) for value, (least, low, high) in rows]

    def from_lerobot(self, values: Sequence[float]) -> list[float]:
        rows = zip(values, self._ranges, strict=True)
        return [_onto(value, least, 100.0, low, high) for value, (least, low, high) in rows]


def _onto(value: float, low: float, high: float, new_low: float, new_high: float) -> float:
    """From one range onto another; what is outside, and no NaN, goes to the nearer end."""
    moved = new_low + (value - low) / (high - low) * (new_high - new_low)
    return new_low if moved < new_low else new_high if moved > new_high else moved


class LerobotLocal:
    """The checkpoint, loaded. Raise ``ValueError`` for one that cannot drive these axes; what
    lerobot raises while it loads passes.

    ``pretrained_name_or_path``: a folder. ``device``: where it runs, ``cpu``, ``cuda``, ``mps``.
    ``unit`` and ``travel``: the driver's, from the tree.
    """

    provider_name = "lerobot_local"
    requires_images = False
    reads_instruction = True

    def __init__(
        self,
        axes: Sequence[str],
        pretrained_name_or_path: str = "",
        units: str = "",
        device: str = "cpu",
        unit: str = "",
        travel: Mapping[str, Sequence[float]] | None = None,
    ) -> None:
        folder = _folder(pretrained_name_or_path)
        self._axes = list(axes)
        self._scale = _scale(self._axes, units, unit, travel or {})

        from lerobot.configs.policies import PreTrainedConfig
        from lerobot.policies.factory import get_policy_class, make_pre_post_processors
        from lerobot.policies.utils import prepare_observation_for_inference

        config = PreTrainedConfig.from_pretrained(folder)
        _check(config, self._axes, folder)
        config.device = self._device = device
        self._prepare = prepare_observation_for_inference
        # Strict: lerobot only logs weights that are missing or left over, and runs what it made up
        # for them.
        self._policy = get_policy_class(config.type).from_pretrained(folder, config=config, strict=True)
        self._into, self._out_of = make_pre_post_processors(
            config, pretrained_path=folder, preprocessor_overrides={"device_processor": {"device": device}}
        )
        # A policy that remembers observations has to see each; of any other, what it plans on one
        # is a chunk.
        remembers = getattr(config, "n_obs_steps", 1) != 1
        self._steps = 1 if remembers else int(getattr(config, "n_action_steps", 1))

    def reset(self, seed: int | None = None) -> None:
        """Begin anew: nothing seen, nothing planned."""
        for part in (self._policy, self._into, self._out_of):
            part.reset()

    def get_actions_sync(
        self, observation: Mapping[str, float], instruction: str, **_: Any
    ) -> list[dict[str, float]]:
        """``n_action_steps`` actions, by ``select_action`` as in lerobot's own control loop: it
        runs the model once and hands out its plan. ``predict_action_chunk`` of some policies reads
        queues that only it fills."""
        import numpy as np

        state = [observation[axis] for axis in self._axes]
        if self._scale is not None:
            state = self._scale.to_lerobot(state)
        seen = {STATE: np.array(state, dtype=np.float32)}
        batch = self._into(self._prepare(seen, self._device, task=instruction))
        return [self._named(self._policy.select_action(dict(batch))) for _ in range(self._steps)]

    def _named(self, action: Any) -> dict[str, float]:
        values: list[float] = self._out_of(action).squeeze(0).tolist()
        if len(values) != len(self._axes):
            raise ValueError(f"lerobot_local: the policy gave {len(values)} numbers for {len(self._axes)} axes")
        if self._scale is not None:
            values = self._scale.from_lerobot(values)
        return dict(zip(self._axes, values, strict=True))


def _folder(given: str) -> str:
    if not given:
        raise ValueError("lerobot_local: no checkpoint. give pretrained_name_or_path, a folder that lerobot saved")
    folder = Path(given).expanduser()
    if not folder.is_dir():
        raise ValueError(
            f"lerobot_local: there is no folder {folder}. give one that lerobot saved; a checkpoint of the Hub is "
            "fetched beforehand: hf download NAME --local-dir FOLDER"
        )
    if missing := [name for name in FILES if not (folder / name).is_file()]:
        raise ValueError(
            f"lerobot_local: {folder} has no {', '.join(missing)}. give a checkpoint as lerobot >= 0.4 saves one, "
            f"with {', '.join(FILES)}; lerobot.processor.migrate_policy_normalization converts an older one"
        )
    return str(folder)


def _scale(axes: Sequence[str], units: str, unit: str, travel: Mapping[str, Sequence[float]]) -> Scale | None:
    """None: the checkpoint's numbers are the driver's."""
    own = unit.partition(" ")[0].strip(",")
    if units and units == own:
        return None
    if units != "normalized":
        known = f"{own!r} or 'normalized'" if own else "'normalized'"
        raise ValueError(
            f"lerobot_local: units is {units!r}. give {known}: what the data of the checkpoint were recorded in "
            "(use_degrees of lerobot's arms), which the checkpoint does not say"
        )
    if missing := [axis for axis in axes if axis not in travel]:
        raise ValueError(
            f"lerobot_local: units='normalized' is a share of each joint's calibrated range, and there is none of "
            f"{', '.join(missing)}. give the robot calibration=, the file of the arm that recorded"
        )
    return Scale(axes, travel)


def _check(config: Any, axes: Sequence[str], folder: str) -> None:
    """``config``: lerobot's ``PreTrainedConfig``."""
    inputs = config.input_features or {}
    if images := sorted(config.image_features):
        raise ValueError(
            f"lerobot_local: {folder} needs images ({', '.join(images)}). a policy is given positions only: use "
            f"a checkpoint whose one input is {STATE}, or serve it yourself and use policy_provider='remote'"
        )
    if others := sorted(set(inputs) - {STATE}):
        raise ValueError(
            f"lerobot_local: {folder} needs {', '.join(others)}. a policy is given positions only: use a "
            f"checkpoint whose one input is {STATE}"
        )
    for name, feature in ((STATE, config.robot_state_feature), ("action", config.action_feature)):
        shape = list(feature.shape) if feature is not None else []
        if shape != [len(axes)]:
            raise ValueError(
                f"lerobot_local: {folder} has {name} of shape {shape}, the robot {len(axes)} axes. use a "
                f"checkpoint of a robot with {', '.join(axes)}, in this order"
            )
