"""Write small checkpoints of LeRobot for an SO-101 with two cameras, to try ``strands-actors run`` with.

``python -m tests.lerobot.checkpoints act|diffusion|smolvla FOLDER`` writes one and prints its folder. The weights
are random: the hub is not needed, and no task is solved. Each target is near the middle of the arm's range, so that
the arm moves by about a degree.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from .small_vla import save as save_smolvla

PICTURE = (3, 120, 160)
CAMERAS = ("front", "wrist")
ABOUT = (0.0, 0.0, 0.0, 0.0, 0.0, 10.0)
"""Degrees; of the gripper percent, which has no target below 0."""
CHUNK, HORIZON = 50, 32


def features() -> dict[str, Any]:
    from lerobot.configs.types import FeatureType, PolicyFeature

    seen = {f"observation.images.{name}": PolicyFeature(FeatureType.VISUAL, PICTURE) for name in CAMERAS}
    state = PolicyFeature(FeatureType.STATE, (len(ABOUT),))
    return {
        "input_features": {"observation.state": state, **seen},
        "output_features": {"action": PolicyFeature(FeatureType.ACTION, (len(ABOUT),))},
        "device": "cpu",
        "push_to_hub": False,
    }


def save_act(folder: Path) -> Path:
    from lerobot.policies.act.configuration_act import ACTConfig
    from lerobot.policies.act.modeling_act import ACTPolicy

    config = ACTConfig(
        **features(), chunk_size=CHUNK, n_action_steps=CHUNK, pretrained_backbone_weights=None, dim_model=128,
        n_heads=4, dim_feedforward=512, n_encoder_layers=2,
    )  # fmt: skip
    return _saved(ACTPolicy(config), config, folder)


def save_diffusion(folder: Path) -> Path:
    from lerobot.policies.diffusion.configuration_diffusion import DiffusionConfig
    from lerobot.policies.diffusion.modeling_diffusion import DiffusionPolicy

    config = DiffusionConfig(
        **features(), horizon=HORIZON, n_action_steps=HORIZON - 2, n_obs_steps=2, down_dims=(64, 128),
        noise_scheduler_type="DDIM", num_inference_steps=5, pretrained_backbone_weights=None,
    )  # fmt: skip
    return _saved(DiffusionPolicy(config), config, folder)


def _saved(policy: Any, config: Any, folder: Path) -> Path:
    import torch
    from lerobot.policies.factory import make_pre_post_processors

    about = torch.tensor(ABOUT)
    figures = {"mean": about, "std": torch.ones(len(ABOUT)), "min": about - 1.0, "max": about + 1.0}
    ones = torch.ones((PICTURE[0], 1, 1))
    pictures = {f"observation.images.{name}": {"mean": 0.5 * ones, "std": 0.25 * ones} for name in CAMERAS}
    policy.save_pretrained(folder)
    for processor in make_pre_post_processors(
        config, dataset_stats={"observation.state": figures, "action": figures, **pictures}
    ):
        processor.save_pretrained(folder)
    return folder


SAVE: dict[str, Callable[[Path], Path]] = {
    "act": save_act,
    "diffusion": save_diffusion,
    "smolvla": lambda folder: save_smolvla(folder, PICTURE, ABOUT, CHUNK, CAMERAS),
}


if __name__ == "__main__":
    import torch

    torch.manual_seed(0)
    print(SAVE[sys.argv[1]](Path(sys.argv[2])))
