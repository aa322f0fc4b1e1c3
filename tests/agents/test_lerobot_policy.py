"""``lerobot_local`` against a stand-in for lerobot, which no test environment has.

``LEROBOT`` follows lerobot 0.4.4 as far as the provider uses it: ``PreTrainedConfig.from_pretrained`` and its
features, ``get_policy_class(type).from_pretrained(folder, config=, strict=)``, ``make_pre_post_processors`` with
``pretrained_path`` and overrides, ``prepare_observation_for_inference``, and a policy whose ``select_action`` plans
``n_action_steps`` on one observation and hands them out one by one. Its tensors are numpy's. Its policy returns
the given state plus ``step`` once per planned action, and records its observations.
"""

from __future__ import annotations

import json
import os
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from strands_actors import Robot
from strands_actors.caller.handle.robot import RealRobot
from strands_actors.contract.driver import Driver
from strands_actors.drivers import get_native_driver_class
from strands_actors.drivers.sim.driver import SimDriver
from strands_actors.policies import registry as policies
from strands_actors.policies.lerobot import FILES, LerobotLocal
from strands_actors.policies.registry import choose_provider, robot_facts
from strands_actors.surfaces import cameras as surfaces_cameras
from strands_actors.surfaces.cameras import Frame, Stale, StaleFrame
from strands_actors.testing import Twin, WireLog
from tests.answers import json_of, task_ended, until, why
from tests.robot.helpers import IDS, holds

AXES = list(IDS)
UNIT = "degrees (gripper: percent open)"
SEEN = dict(zip(AXES, (0.0, 10.0, -20.0, 30.0, -40.0, 50.0), strict=True))

LEROBOT = {
    "configs/policies.py": """
import json, pathlib, types

class PreTrainedConfig:
    @classmethod
    def from_pretrained(cls, pretrained_name_or_path):
        config = cls()
        content = json.loads((pathlib.Path(pretrained_name_or_path) / "config.json").read_text())
        for key in ("input_features", "output_features"):
            content[key] = {name: types.SimpleNamespace(**feature) for name, feature in content[key].items()}
        vars(config).update(content)
        config.image_features = {n: f for n, f in config.input_features.items() if f.type == "VISUAL"}
        config.robot_state_feature = config.input_features.get("observation.state")
        config.action_feature = config.output_features.get("action")
        return config
""",
    "policies/rtc/configuration_rtc.py": """
class RTCConfig:
    def __init__(self, enabled, execution_horizon):
        self.enabled = enabled
        self.execution_horizon = execution_horizon
""",
    "policies/factory.py": """
import collections

calls = []

class StandInPolicy:
    @classmethod
    def from_pretrained(cls, pretrained_name_or_path, *, config=None, strict=False):
        calls.append(("weights", config.device, strict))
        policy = cls()
        policy.config = config
        policy.reset()
        return policy

    def reset(self):
        calls.append(("reset",))
        self.plan = collections.deque()
        if getattr(self.config, "queues", False):
            self.seen = collections.deque(maxlen=self.config.n_obs_steps)
            self._queues = {"action": self.plan, "observation.state": self.seen}

    def select_action(self, batch):
        if getattr(self.config, "queues", False):
            self.seen.append(batch["observation.state"].tolist())
        if not self.plan:
            if getattr(self.config, "queues", False):
                calls.append(("seen", list(self.seen)))
            calls.append(("plan", batch))
            state = batch["observation.state"]
            width = self.config.gives
            steps = range(1, getattr(self.config, "n_action_steps", 1) + 1)
            self.plan.extend((state + self.config.step * step)[:, :width] for step in steps)
        return self.plan.popleft()

    def predict_action_chunk(self, batch, inference_delay, prev_chunk_left_over):
        assert self.config.rtc_config.enabled
        rest = None if prev_chunk_left_over is None else prev_chunk_left_over.tolist()
        calls.append(("chunk", inference_delay, rest))
        state = batch["observation.state"]
        chunk = [state + self.config.step * step for step in range(1, self.config.chunk_size + 1)]
        import numpy
        return numpy.stack(chunk, axis=1)

class Processor:
    def __init__(self, change):
        self.change = change

    def __call__(self, data):
        return self.change(data)

    def reset(self):
        pass

def get_policy_class(name):
    return {"stand_in": StandInPolicy}[name]

def make_pre_post_processors(policy_cfg, pretrained_path=None, preprocessor_overrides=None):
    calls.append(("processors", preprocessor_overrides))
    def into(batch):
        return {**batch, "observation.state": batch["observation.state"] / 10}
    return Processor(into), Processor(lambda action: action * 10)
""",
    "policies/utils.py": """
def prepare_observation_for_inference(observation, device, task=None, robot_type=None):
    return {**{name: value[None] for name, value in observation.items()}, "task": task or "", "robot_type": ""}
""",
}

TORCH = """
threads = [64]

def get_num_threads():
    return threads[-1]

def set_num_threads(count):
    threads.append(count)
"""

Save = Callable[..., Path]


@pytest.fixture
def lerobot(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Make the stand-in importable in this process and in its child processes."""
    root = tmp_path / "site"
    for name, source in LEROBOT.items():
        path = root / "lerobot" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(source)
    for package in ("", "configs", "policies", "policies/rtc"):
        (root / "lerobot" / package / "__init__.py").touch()
    (root / "torch.py").write_text(TORCH)
    monkeypatch.syspath_prepend(str(root))
    yield root
    for name in [name for name in sys.modules if name.partition(".")[0] in ("lerobot", "torch")]:
        del sys.modules[name]


@pytest.fixture
def save(tmp_path: Path, lerobot: Path) -> Save:
    """Write a checkpoint of the stand-in; keywords change its configuration."""

    def write(inputs: Mapping[str, Any] | None = None, size: int = 6, **config: Any) -> Path:
        folder = tmp_path / "checkpoint"
        folder.mkdir()
        for name in FILES:
            (folder / name).touch()
        content = {
            "type": "stand_in",
            "input_features": {"observation.state": {"type": "STATE", "shape": [size]}, **(inputs or {})},
            "output_features": {"action": {"type": "ACTION", "shape": [size]}},
            "step": 0.0,
            "gives": size,
            **config,
        }
        (folder / "config.json").write_text(json.dumps(content))
        return folder

    return write


def calls() -> list[tuple[Any, ...]]:
    from lerobot.policies import factory

    found: list[tuple[Any, ...]] = factory.calls
    return found


def load(folder: Path | str, **options: Any) -> LerobotLocal:
    given = {"axes": AXES, "unit": UNIT, "units": "degrees", **options}
    return LerobotLocal(pretrained_name_or_path=str(folder), **given)


# -- output


def test_a_chunk_has_the_planned_actions_of_one_observation_by_axis(save: Save) -> None:
    policy = load(save(n_action_steps=3, step=0.1), device="cuda")
    policy.reset()
    chunk = policy.get_actions_sync(SEEN, "pick it up")
    assert [list(action) for action in chunk] == [AXES] * 3
    for step, action in enumerate(chunk, start=1):  # the checkpoint's processors normalise and convert back
        assert action == pytest.approx({axis: SEEN[axis] + step for axis in AXES}, abs=1e-4)
    plans = [call[1] for call in calls() if call[0] == "plan"]
    assert len(plans) == 1
    assert plans[0]["task"] == "pick it up"
    assert plans[0]["observation.state"].tolist() == [pytest.approx([value / 10 for value in SEEN.values()])]


def test_the_checkpoint_is_loaded_strictly_and_on_the_given_device(save: Save) -> None:
    load(save(), device="cuda")
    assert ("weights", "cuda", True) in calls()
    assert ("processors", {"device_processor": {"device": "cuda"}}) in calls()


@pytest.mark.parametrize(("processors", "threads"), [(1, 1), (2, 1), (8, 7), (128, 64)])
def test_torch_leaves_a_processor_to_the_robot(
    save: Save, monkeypatch: pytest.MonkeyPatch, processors: int, threads: int
) -> None:
    monkeypatch.setattr(os, "cpu_count", lambda: processors)
    load(save())
    assert sys.modules["torch"].get_num_threads() == threads


def test_a_policy_that_remembers_sees_every_observation(save: Save) -> None:
    policy = load(save(n_action_steps=3, n_obs_steps=2))
    assert [len(policy.get_actions_sync(SEEN, "")) for _ in range(2)] == [1, 1]


def test_a_policy_with_queues_collects_its_observations_and_then_gives_its_whole_chunk(save: Save) -> None:
    policy = load(save(n_action_steps=3, n_obs_steps=2, queues=True, step=0.1))
    policy.reset()
    later = {axis: value + 10.0 for axis, value in SEEN.items()}
    for _ in range(2):
        assert policy.get_actions_sync(SEEN, "") == []
        chunk = policy.get_actions_sync(later, "")
        expected = [later["gripper"] + step for step in (1, 2, 3)]
        assert [action["gripper"] for action in chunk] == pytest.approx(expected, abs=1e-3)
    pairs = [call[1] for call in calls() if call[0] == "seen"]
    assert [[row[0][0] for row in pair] for pair in pairs] == [
        pytest.approx([SEEN[AXES[0]] / 10, later[AXES[0]] / 10])
    ] * 2


def test_an_aligned_chunk_leaves_out_the_actions_whose_time_has_passed(save: Save) -> None:
    policy = load(save(n_action_steps=4, step=0.1), align=True)
    policy.reset()
    assert len(policy.get_actions_sync(SEEN, "")) == 4
    policy.actions_left(3)
    (last,) = policy.get_actions_sync(SEEN, "")
    assert last == pytest.approx({axis: value + 4 for axis, value in SEEN.items()}, abs=1e-4)
    policy.actions_left(4)
    with pytest.raises(ValueError, match="4 actions are still to be executed, and the new chunk has 4"):
        policy.get_actions_sync(SEEN, "")


def test_align_is_for_chunks(save: Save) -> None:
    with pytest.raises(ValueError, match="align is for chunks of several actions"):
        load(save(n_action_steps=3, n_obs_steps=2), align=True)


def test_axes_have_the_order_of_the_robot_and_not_of_the_observation(save: Save) -> None:
    backwards = dict(reversed(SEEN.items()))
    assert load(save()).get_actions_sync(backwards, "") == [pytest.approx(SEEN, abs=1e-4)]


# -- units

TRAVEL = dict.fromkeys(AXES[:-1], (-50.0, 100.0)) | {"gripper": (0.0, 100.0)}


def test_normalized_is_a_share_of_the_calibrated_range(save: Save) -> None:
    policy = load(save(step=1.0), units="normalized", travel=TRAVEL)
    (action,) = policy.get_actions_sync({**dict.fromkeys(AXES, 25.0), "wrist_roll": 130.0}, "")
    (plan,) = (call[1]["observation.state"].tolist() for call in calls() if call[0] == "plan")
    assert plan == [pytest.approx([0.0, 0.0, 0.0, 0.0, 10.0, 2.5])]  # of -100..100 and 0..100, clipped, by ten
    # 10 of 200 is 7.5 of 150 degrees. A value past the end is clipped.
    assert action == pytest.approx({**dict.fromkeys(AXES, 32.5), "wrist_roll": 100.0, "gripper": 35.0})
    assert action["wrist_roll"] <= 100.0


@pytest.mark.parametrize("units", ["", "radians", "percent", None])
def test_units_are_never_guessed(save: Save, units: Any) -> None:
    with pytest.raises(ValueError, match=r"units is .* Give 'degrees' or 'normalized', the units of"):
        load(save(), units=units)


def test_the_drivers_unit_is_accepted(save: Save) -> None:
    folder = save()
    with pytest.raises(ValueError, match=r"units is 'degrees'\. Give 'radians' or 'normalized'"):
        load(folder, unit="radians")
    load(folder, unit="radians", units="radians")


def test_no_calibration_no_normalized_units(save: Save) -> None:
    with pytest.raises(
        ValueError, match=r"calibrated range, which is unknown for shoulder_pan, .*Give the robot cal"
    ):
        load(save(), units="normalized", travel={})


def driver_of(robot: str, **options: Any) -> Driver:
    driver_class = get_native_driver_class(robot)
    return driver_class(robot, "/dev/null", driver_class.resolve(robot, options))


def test_a_calibrated_arm_passes_its_travel_only_to_a_policy_that_accepts_it() -> None:
    motor = {"drive_mode": 0, "homing_offset": 0, "range_min": 1024, "range_max": 3071}
    calibration = {axis: {"id": id, **motor} for axis, id in IDS.items()}
    arm = driver_of("so101", calibration=calibration)
    where, _ = choose_provider("mock", "localhost", None, {})
    assert robot_facts(where, arm) == {"axes": AXES}
    facts = robot_facts(policies.PROVIDERS["lerobot_local"], arm)
    half = (3071 - 1024) / 2 * 360 / 4095  # lerobot's degrees of the same file
    assert facts["unit"] == UNIT
    assert facts["travel"] == {axis: pytest.approx((-half, half)) for axis in AXES[:-1]} | {
        "gripper": pytest.approx((0.0, 100.0))
    }
    assert driver_of("so101").travel() == {}
    same = {"class": "strands_actors.drivers.feetech.driver:Feetech", "options": {"calibration": calibration}}
    assert SimDriver("so101", "", same).travel() == facts["travel"]


# -- refusals


def test_a_missing_checkpoint_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"no checkpoint is given\. Set pretrained_name_or_path"):
        load("")
    with pytest.raises(
        ValueError, match=r"there is no folder .*nowhere. Give one that lerobot saved; .*hf download"
    ):
        load(tmp_path / "nowhere")


@pytest.mark.parametrize("name", FILES)
def test_half_a_checkpoint_is_named(save: Save, name: str) -> None:
    folder = save()
    (folder / name).unlink()
    with pytest.raises(ValueError, match=rf"has no {name}\. Give a checkpoint as lerobot >= 0\.4 saves one"):
        load(folder)


IMAGES = {f"observation.images.{name}": {"type": "VISUAL", "shape": [3, 480, 640]} for name in ("wrist", "top")}
CUBE = {"observation.environment_state": {"type": "ENV", "shape": [3]}}


@pytest.mark.parametrize(
    ("inputs", "text"),
    [
        (
            IMAGES,
            r"needs images \(.*top, observation.images.wrist\), and the robot has no cameras. Give Robot cameras=",
        ),
        (CUBE, "needs observation.environment_state, but a policy gets only positions and pictures"),
    ],
)
def test_a_checkpoint_that_needs_more_than_positions_is_refused(
    save: Save, inputs: Mapping[str, Any], text: str
) -> None:
    with pytest.raises(ValueError, match=text):
        load(save(inputs))


# -- pictures


class Reader:
    """A camera, as ``attach_camera`` gives it."""

    def __init__(self, robot: str, camera: str) -> None:
        assert robot == "so101"
        self.camera = camera

    def newest(self) -> Frame | Stale:
        return SIGHTS[self.camera]


SIGHTS: dict[str, Frame | Stale] = {}


@pytest.fixture
def sights(monkeypatch: pytest.MonkeyPatch) -> dict[str, Frame | Stale]:
    """The present picture of each camera. A test changes it."""
    monkeypatch.setattr(surfaces_cameras, "attach_camera", Reader)
    SIGHTS.clear()
    SIGHTS.update({name: Frame(np.full((480, 640, 3), 7, np.uint8), 1, 1) for name in ("wrist", "top")})
    return SIGHTS


def test_a_policy_gets_the_newest_picture_of_each_camera(save: Save, sights: dict[str, Frame | Stale]) -> None:
    wide = {"observation.images.camera1": {"type": "VISUAL", "shape": [3, 480, 640]}}
    policy = load(
        save(wide),
        robot="so101",
        cameras=["wrist", "top"],
        rename_map={"observation.images.wrist": "observation.images.camera1"},
    )
    assert policy.requires_images
    policy.reset()
    policy.get_actions_sync(SEEN, "")
    (plan,) = (call[1] for call in calls() if call[0] == "plan")
    assert plan["observation.images.camera1"].shape == (1, 480, 640, 3)
    assert "observation.images.wrist" not in plan


def test_a_stale_picture_ends_the_rollout_and_another_size_is_refused(
    save: Save, sights: dict[str, Frame | Stale]
) -> None:
    policy = load(save(IMAGES), robot="so101", cameras=["wrist", "top"])
    policy.reset()
    sights["top"] = Stale("it was unplugged", 1.0, 3)
    with pytest.raises(StaleFrame, match="camera 'top': it was unplugged"):
        policy.get_actions_sync(SEEN, "")
    sights["top"] = Frame(np.zeros((240, 320, 3), np.uint8), 1, 4)
    with pytest.raises(
        ValueError, match=r"camera 'top' gives 320 x 240, and observation.images.top of .* 640 x 480"
    ):
        policy.get_actions_sync(SEEN, "")


def test_a_missing_camera_is_named(save: Save, sights: dict[str, Frame | Stale]) -> None:
    with pytest.raises(
        ValueError, match=r"needs images \(observation.images.top\), and the robot has cameras wrist"
    ):
        load(save(IMAGES), robot="so101", cameras=["wrist"])


# -- real-time chunking


def test_real_time_chunking_gets_the_rest_of_the_chunk_without_the_actions_that_will_still_be_executed(
    save: Save,
) -> None:
    folder = save(step=0.1, chunk_size=8, rtc_config=None)
    policy = load(folder, rtc=True, execution_horizon=4)
    policy.reset()
    policy.actions_left(0)
    still = dict.fromkeys(AXES, 0.0)
    first = policy.get_actions_sync(still, "")
    assert [action["gripper"] for action in first] == pytest.approx([1.0, 2.0, 3.0, 4.0])
    policy.actions_left(1)  # 4.0 will still be executed when the next chunk begins
    second = policy.get_actions_sync(still, "")
    assert [action["gripper"] for action in second] == pytest.approx([2.0, 3.0, 4.0, 5.0])
    policy.actions_left(3)
    third = policy.get_actions_sync(still, "")
    assert [action["gripper"] for action in third] == pytest.approx([4.0, 5.0, 6.0, 7.0])
    requests = [
        (call[1], None if call[2] is None else [row[0] for row in call[2]])
        for call in calls()
        if call[0] == "chunk"
    ]
    assert requests[0] == (0, None)
    assert requests[1] == (1, pytest.approx([0.4, 0.5, 0.6, 0.7, 0.8]))
    assert requests[2] == (3, pytest.approx([0.3, 0.4, 0.5, 0.6, 0.7, 0.8]))
    policy.actions_left(0)
    policy.reset()
    policy.get_actions_sync(still, "")
    assert calls()[-1] == ("chunk", 0, None)


def test_a_policy_without_real_time_chunking_is_refused(save: Save) -> None:
    folder = save(chunk_size=8)
    with pytest.raises(ValueError, match="a policy of type 'stand_in' has no real-time chunking"):
        load(folder, rtc=True)


def test_a_checkpoint_of_another_robot_is_refused(save: Save) -> None:
    with pytest.raises(
        ValueError, match=r"has observation.state of shape \[7\], the robot has 6 axes. Use .* shoulder_pan"
    ):
        load(save(size=7))


@pytest.mark.parametrize("key", ["input_features", "output_features"])
def test_a_checkpoint_without_state_or_action(save: Save, key: str) -> None:
    with pytest.raises(ValueError, match=r"of shape \[\], the robot has 6 axes"):
        load(save(**{key: {}}))


def test_a_policy_that_gives_too_little(save: Save) -> None:
    policy = load(save(gives=5))
    with pytest.raises(ValueError, match="the policy returned 5 numbers for 6 axes"):
        policy.get_actions_sync(SEEN, "")


# -- on the arm


def test_a_checkpoint_drives_the_arm(save: Save, arm: RealRobot, twin: Twin) -> None:
    folder = save(n_action_steps=4, step=0.02)
    task = {"policy_provider": "lerobot_local", "pretrained_name_or_path": str(folder)}
    began_ns = time.monotonic_ns()
    json_of(arm.start_task("wave", **task, units="degrees"))
    until(lambda: len(twin.log.host("setpoint", began_ns)) > 12, "it moves by chunks")
    ended = json_of(arm.stop_task())
    assert (ended["exit_reason"], ended["instruction"]) == ("stopped", "wave"), ended
    assert holds(twin.log, began_ns)


def test_a_task_without_units_moves_nothing(save: Save, arm: RealRobot, twin: Twin) -> None:
    json_of(arm.start_task("wave", policy_provider="lerobot_local", pretrained_name_or_path=str(save())))
    ended = task_ended(arm)
    assert ended["exit_reason"] == "policy", ended
    assert "Give 'degrees' or 'normalized'" in ended["exit_detail"]
    assert not twin.log.host("setpoint")
    assert "takes no policy_port" in why(arm.start_task("wave", 8000, policy_provider="lerobot_local"))


def test_a_checkpoint_with_a_camera_drives_the_arm_until_the_camera_is_gone(
    save: Save, run_dir: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """SAF-001: a missing picture ends the rollout, and the robot holds."""
    monkeypatch.setenv("STRANDS_ACTORS_TWIN_LOG", str(run_dir / "wire"))
    plug = run_dir / "plug"
    plug.touch()
    shape = {"observation.images.wrist": {"type": "VISUAL", "shape": [3, 32, 48]}}
    folder = save(shape, n_action_steps=4, step=0.02)
    camera = {"type": "tests.cameras.sources:plugged", "view": str(plug), "fps": 10, "width": 48, "height": 32}
    with Robot("so101", mode="real", transport="twin", cameras={"wrist": camera}) as arm:
        log = WireLog(run_dir / "wire")
        began_ns = time.monotonic_ns()
        task = {"policy_provider": "lerobot_local", "pretrained_name_or_path": str(folder)}
        json_of(arm.start_task("wave", **task, units="degrees", duration=60.0))
        until(lambda: len(log.host("setpoint", began_ns)) > 12, "it moves by what it sees")
        plug.unlink()
        ended = task_ended(arm)
        assert ended["exit_reason"] == "policy", (ended["exit_detail"], log.story(began_ns))
        assert "camera 'wrist'" in ended["exit_detail"]
        assert holds(log, began_ns)
