"""The policy ``lerobot_local``: a checkpoint of lerobot, run in the policy's process.

A checkpoint is a folder with a trained model that lerobot >= 0.4 has saved: configuration, weights, and the two
processors that normalise inputs and outputs. Its inputs are positions, the instruction, and pictures of the robot's
cameras: ``observation.images.wrist`` is the camera ``wrist``. A checkpoint is refused if it needs a camera that the
robot does not have, or a state of another size. Nothing is downloaded here.

Pictures are read when an inference begins. Once the robot moves, the policy never waits for a picture: if a picture
is too old, the policy run ends, and the robot holds its position.

With ``rtc=True`` a flow-matching policy (pi0, pi05, smolvla) blends each chunk into the previous one
(lerobot's real-time chunking). Its input then has the rest of the previous chunk, and the number of
actions in it that will be executed before the new chunk.

A policy that reads several observations (diffusion, vqbet) collects them one period apart before each chunk, and
returns no action meanwhile. So its chunk, too, is computed while the last one is executed.

A chunk begins at the time of its observation, and is executed when the last chunk ends. With ``align=True`` the
actions whose time has passed by then are left out. So each action is executed at the time for which it was planned.

A checkpoint does not state the units of its numbers. They depend on the recording of its data
(``use_degrees`` of lerobot's arms; the default differs by arm and version). So ``units`` has no default:

``degrees``      (or the driver's own unit) The numbers are in the driver's units. They have the same meaning
                 only under the calibration of the recording arm, which defines zero.
``normalized``   The other scale of lerobot: -100..100 over the calibrated range of each joint, 0..100 for the
                 gripper. The driver needs a calibration.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .scale import NORMALIZED, Scale, unit_word

if TYPE_CHECKING:
    from strands_actors.surfaces.cameras import CameraReader

Attach = Callable[[str, str], "CameraReader"]
IMAGES = "observation.images."
FIRST_PICTURE_S = 15.0
"""How long to wait for the first picture of a camera that was just started. Nothing moves before it."""
LOOK_S = 0.02
HORIZON = 10
"""Number of actions of a chunk that are executed before the next chunk is blended in (lerobot's default)."""
STATE, ACTION = "observation.state", "action"
FILES = ("config.json", "model.safetensors", "policy_preprocessor.json", "policy_postprocessor.json")


class LerobotLocal:
    """Load a checkpoint and run it as a policy.

    This package sets ``axes``, ``unit``, ``travel``, ``robot`` and ``cameras``, from the robot. The user gives
    the other arguments as options of ``start_task``.

    Args:
        axes: Names of the robot's axes, in order.
        pretrained_name_or_path: Folder of the checkpoint.
        units: Units of the checkpoint's numbers, ``degrees``, the driver's own unit or ``normalized`` (see the
            docstring of the module).
        device: ``cpu``, ``cuda`` or ``mps``.
        unit: The unit of the driver's positions.
        travel: Calibrated range of each axis.
        robot: Name under which the robot was started.
        cameras: Names of the robot's cameras.
        rename_map: The name that each camera has in the checkpoint, in lerobot's form:
            ``{"observation.images.wrist": "observation.images.camera1"}``.
        rtc: Use real-time chunking, which blends each chunk of actions into the previous one.
        execution_horizon: Number of actions of each chunk that are executed with ``rtc``.
        align: Leave out the first actions of each chunk, whose time has passed when they could be executed.
        attach: Returns the reader of a camera, by the names of robot and camera. None: ``attach_camera``.

    Raises:
        ValueError: The checkpoint cannot control these axes. Exceptions of lerobot while it loads are not
            caught.
    """

    provider_name = "lerobot_local"
    reads_instruction = True

    def __init__(
        self,
        axes: Sequence[str],
        pretrained_name_or_path: str = "",
        units: str = "",
        device: str = "cpu",
        unit: str = "",
        travel: Mapping[str, Sequence[float]] | None = None,
        robot: str = "",
        cameras: Sequence[str] = (),
        rename_map: Mapping[str, str] | None = None,
        rtc: bool = False,
        execution_horizon: int = HORIZON,
        align: bool = False,
        attach: Attach | None = None,
    ) -> None:
        folder = checkpoint_folder(pretrained_name_or_path)
        self._axes = list(axes)
        self._scale = _scale(self._axes, units, unit, travel or {})

        from lerobot.configs.policies import PreTrainedConfig
        from lerobot.policies.factory import get_policy_class, make_pre_post_processors
        from lerobot.policies.utils import prepare_observation_for_inference

        _leave_a_processor()
        config = PreTrainedConfig.from_pretrained(folder)
        _check(config, self._axes, folder)
        self._eyes = _eyes(config, robot, cameras, rename_map or {}, folder, attach)
        self.requires_images = bool(self._eyes)
        self.supports_rtc = rtc
        self.execution_horizon = execution_horizon
        if rtc:
            _chunk_in_real_time(config, execution_horizon)
        # The part of the model's last chunk from the first returned action on.
        self._rest: Any = None
        self._handed_out = self._pending = 0
        config.device = self._device = device
        self._prepare = prepare_observation_for_inference
        # Without ``strict`` lerobot only logs missing or unused weights, and runs with arbitrary values in
        # place of the missing ones.
        self._policy = get_policy_class(config.type).from_pretrained(folder, config=config, strict=True)
        self._into, self._out_of = make_pre_post_processors(
            config, pretrained_path=folder, preprocessor_overrides={"device_processor": {"device": device}}
        )
        # A policy that remembers observations in another way than in queues must get every observation, so it
        # returns one action at a time. Any other policy returns all actions that it has planned.
        self._observations = int(getattr(config, "n_obs_steps", 1))
        self._collects = self._observations != 1 and ACTION in (getattr(self._policy, "_queues", None) or {})
        steps = int(getattr(config, "n_action_steps", 1))
        self._steps = steps if self._observations == 1 or self._collects else 1
        if align and (rtc or self._steps == 1):
            raise ValueError("lerobot_local: align is for chunks of several actions, without rtc. Leave align out")
        self._aligns = align
        self._collected = 0

    def reset(self, seed: int | None = None) -> None:
        """Forget observations and plans, and wait for the first pictures.

        Args:
            seed: Has no effect.

        Raises:
            StaleFrame: A camera has sent no picture within ``FIRST_PICTURE_S``.
        """
        for part in (self._policy, self._into, self._out_of):
            part.reset()
        self._rest, self._handed_out, self._pending, self._collected = None, 0, 0, 0
        for eye in self._eyes:
            eye.wait()

    def actions_left(self, count: int) -> None:
        """Set the number of returned actions that are not executed yet.

        They will be executed before the actions of the next chunk.
        """
        self._pending = count

    def get_actions_sync(
        self, observation: Mapping[str, float], instruction: str, **_: Any
    ) -> list[dict[str, float]]:
        """Return the next ``n_action_steps`` actions, or at most ``execution_horizon`` with ``rtc``.

        The list is empty if the policy needs one more observation first.

        Without ``rtc`` it calls ``select_action``, as lerobot's own control loop does. That runs the model once
        and then returns its plan step by step. ``predict_action_chunk`` cannot be used here: some
        policies read queues that only ``select_action`` fills.
        """
        import numpy as np

        state = [observation[axis] for axis in self._axes]
        if self._scale is not None:
            state = self._scale.to_lerobot(state)
        inputs = {STATE: np.array(state, dtype=np.float32)} | {eye.key: eye.look() for eye in self._eyes}
        batch = self._into(self._prepare(inputs, self._device, task=instruction))
        if self.supports_rtc:
            return self._blended(batch)
        if self._collects and self._collects_one_more(batch):
            return []
        first = self._policy.select_action(dict(batch))
        if self._collects:
            queue = self._policy._queues[ACTION]
            planned = [first, *queue]
            queue.clear()
        else:
            planned = [first, *(self._policy.select_action(dict(batch)) for _ in range(self._steps - 1))]
        passed = self._pending if self._aligns else 0
        if passed >= len(planned):
            raise ValueError(
                f"lerobot_local: {passed} actions are still to be executed, and the new chunk has {len(planned)}. "
                "Leave align out, or give a lower control_frequency"
            )
        return [self._named(action) for action in planned[passed:]]

    def _collects_one_more(self, batch: Any) -> bool:
        """Give an observation to the policy if it needs further ones before the next chunk. Return True then.

        ``select_action`` stores its observation, and computes a chunk only if its queue of actions is empty.
        """
        self._collected = (self._collected + 1) % self._observations
        if self._collected == 0:
            return False
        self._policy._queues[ACTION].append(None)
        self._policy.select_action(dict(batch))
        return True

    def _blended(self, batch: Any) -> list[dict[str, float]]:
        """Return the actions of a new chunk, without those that were returned before and are still to be executed.

        The new chunk begins at the present time. So its first actions are the pending actions, and they are left
        out.
        """
        pending = min(self._pending, self._handed_out)
        rest = None if self._rest is None else self._rest[self._handed_out - pending :]
        chunk = self._policy.predict_action_chunk(dict(batch), inference_delay=pending, prev_chunk_left_over=rest)
        self._rest = chunk.squeeze(0)[pending:]
        rows = self._out_of(chunk).squeeze(0)[pending:].tolist()
        self._handed_out = min(len(rows), self.execution_horizon)
        if not rows:
            raise ValueError(
                f"lerobot_local: {pending} actions are still to be executed, and the new chunk is not longer. "
                "Give a smaller execution_horizon, or a lower control_frequency"
            )
        return [self._by_axis(row) for row in rows[: self._handed_out]]

    def _named(self, action: Any) -> dict[str, float]:
        return self._by_axis(self._out_of(action).squeeze(0).tolist())

    def _by_axis(self, values: list[float]) -> dict[str, float]:
        if len(values) != len(self._axes):
            raise ValueError(f"lerobot_local: the policy returned {len(values)} numbers for {len(self._axes)} axes")
        if self._scale is not None:
            values = self._scale.from_lerobot(values)
        return dict(zip(self._axes, values, strict=True))


class Eye:
    """One camera of a checkpoint.

    Args:
        key: Name of the camera in the checkpoint.
        reader: The object that reads the camera's pictures.
        shape: Number of colours, height and width that the checkpoint expects; None for any.
    """

    def __init__(self, key: str, reader: CameraReader, shape: Sequence[int] | None) -> None:
        self.key = key
        self._reader = reader
        self._shape = None if shape is None else tuple(shape)

    def wait(self) -> None:
        """Wait for the camera's first picture. Raise ``StaleFrame`` if it does not come in time."""
        until_s = time.monotonic() + FIRST_PICTURE_S
        while self._is_blind() and time.monotonic() < until_s:
            time.sleep(LOOK_S)
        self.look()

    def look(self) -> Any:
        """Return the newest picture, an array of (height, width, colours).

        Raises:
            StaleFrame: The newest picture is too old.
            ValueError: The picture has another size than the checkpoint expects.
        """
        from strands_actors.surfaces.cameras import Stale, StaleFrame

        newest = self._reader.newest()
        if isinstance(newest, Stale):
            raise StaleFrame(self._reader.camera, newest)
        height, width, colours = newest.image.shape
        if self._shape is not None and (colours, height, width) != self._shape:
            raise ValueError(
                f"lerobot_local: camera {self._reader.camera!r} gives {width} x {height}, and {self.key} of the "
                f"checkpoint is {self._shape[-1]} x {self._shape[-2]}. Set the camera to the size of the checkpoint"
            )
        return newest.image

    def _is_blind(self) -> bool:
        from strands_actors.surfaces.cameras import Stale

        return isinstance(self._reader.newest(), Stale)


def _eyes(
    config: Any,
    robot: str,
    cameras: Sequence[str],
    rename_map: Mapping[str, str],
    folder: str,
    attach: Attach | None,
) -> list[Eye]:
    """Return an ``Eye`` (a camera) for each picture that the checkpoint needs.

    Raises:
        ValueError: The robot lacks a camera that the checkpoint needs.
    """
    features = dict(config.image_features or {})
    if not features:
        return []
    from strands_actors.surfaces.cameras import attach_camera
    from strands_actors.surfaces.cameras.picture_files import cameras_of

    # A caller on another computer does not know the robot's cameras.
    cameras = cameras or cameras_of(robot)
    named = {rename_map.get(f"{IMAGES}{camera}", f"{IMAGES}{camera}"): camera for camera in cameras}
    if missing := sorted(set(features) - set(named)):
        has = f"cameras {', '.join(cameras)}" if cameras else "no cameras"
        raise ValueError(
            f"lerobot_local: {folder} needs images ({', '.join(missing)}), and the robot has {has}. Give Robot "
            f"cameras={{{missing[0].removeprefix(IMAGES)!r}: {{...}}}}, or rename_map"
        )
    read = attach or attach_camera
    return [Eye(key, read(robot, named[key]), feature.shape) for key, feature in features.items()]


def _chunk_in_real_time(config: Any, execution_horizon: int) -> None:
    """Switch on real-time chunking. Raise ``ValueError`` if this type of policy does not have it."""
    if not hasattr(config, "rtc_config"):
        raise ValueError(
            f"lerobot_local: rtc=True, and a policy of type {config.type!r} has no real-time chunking. Omit rtc"
        )
    if isinstance(execution_horizon, bool) or not isinstance(execution_horizon, int) or execution_horizon < 1:
        raise ValueError(f"lerobot_local: execution_horizon is {execution_horizon!r}. Give a whole number above 0")
    from lerobot.policies.rtc.configuration_rtc import RTCConfig

    config.rtc_config = RTCConfig(enabled=True, execution_horizon=execution_horizon)


def _leave_a_processor() -> None:
    """Let torch use one processor less than there are, since robot and cameras need one.

    The threads of torch wait for each other after each layer. On a computer with two processors, with both
    used by torch, an inference took 2.5 s instead of 0.15 s.
    """
    import torch

    torch.set_num_threads(min(torch.get_num_threads(), max(1, (os.cpu_count() or 1) - 1)))


def checkpoint_folder(path: str) -> str:
    """Return the path of a checkpoint. Raise ``ValueError`` if it is not a folder with all files of one."""
    if not path:
        raise ValueError("lerobot_local: no checkpoint is given. Set pretrained_name_or_path to its folder")
    folder = Path(path).expanduser()
    if not folder.is_dir():
        raise ValueError(
            f"lerobot_local: there is no folder {folder}. Give one that lerobot saved; a checkpoint of the Hub is "
            "fetched beforehand: hf download NAME --local-dir FOLDER"
        )
    if missing := [name for name in FILES if not (folder / name).is_file()]:
        raise ValueError(
            f"lerobot_local: {folder} has no {', '.join(missing)}. Give a checkpoint as lerobot >= 0.4 saves one, "
            f"with {', '.join(FILES)}; lerobot.processor.migrate_policy_normalization converts an older one"
        )
    return str(folder)


def _scale(axes: Sequence[str], units: str, unit: str, travel: Mapping[str, Sequence[float]]) -> Scale | None:
    """Return the conversion between the driver's units and the checkpoint's units; None if they are the same."""
    own = unit_word(unit)
    if units and units == own:
        return None
    if units != NORMALIZED:
        choices = f"{own!r} or 'normalized'" if own else "'normalized'"
        raise ValueError(
            f"lerobot_local: units is {units!r}. Give {choices}, the units of the checkpoint's training data (see "
            "use_degrees of lerobot's arms). The checkpoint does not state them"
        )
    try:
        return Scale(axes, travel)
    except ValueError as missing:
        raise ValueError(f"lerobot_local: {missing}") from None


def _check(config: Any, axes: Sequence[str], folder: str) -> None:
    """Check that the inputs and outputs of a checkpoint fit these axes.

    Args:
        config: lerobot's ``PreTrainedConfig``.
        axes: Names of the robot's axes, in order.
        folder: The checkpoint's folder, for the text of an exception.

    Raises:
        ValueError: The checkpoint does not fit.
    """
    inputs = config.input_features or {}
    if others := sorted(set(inputs) - {STATE} - set(config.image_features or {})):
        raise ValueError(
            f"lerobot_local: {folder} needs {', '.join(others)}, but a policy gets only positions and pictures. "
            f"Use a checkpoint with the inputs {STATE} and images"
        )
    for name, feature in ((STATE, config.robot_state_feature), ("action", config.action_feature)):
        shape = list(feature.shape) if feature is not None else []
        if shape != [len(axes)]:
            raise ValueError(
                f"lerobot_local: {folder} has {name} of shape {shape}, the robot has {len(axes)} axes. Use a "
                f"checkpoint of a robot with {', '.join(axes)}, in this order"
            )
