"""A SmolVLA of LeRobot's with layers for dolls: what is fetched from the Hub for a real one is made
here, so nothing is downloaded."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

WORDS = ("<pad>", "<unk>", "<image>", "<fake_token_around_image>", "<global-img>", "<end_of_utterance>", "swing")
SIZE = 64
"""Of a picture, in pixels, as the model sees it."""


def save(
    folder: Path,
    picture: tuple[int, int, int],
    about: Sequence[float],
    chunk: int,
    cameras: Sequence[str] = ("front",),
) -> Path:
    """Write a checkpoint whose actions are ``about`` these positions, with a spread of 1; return
    where it is. ``picture``: colours, height and width of the pictures of the ``cameras``."""
    import torch
    from lerobot.configs.types import FeatureType, PolicyFeature
    from lerobot.policies.factory import make_pre_post_processors
    from lerobot.policies.smolvla.configuration_smolvla import SmolVLAConfig
    from lerobot.policies.smolvla.modeling_smolvla import SmolVLAPolicy

    _save_vlm(folder / "vlm")
    torch.manual_seed(0)
    axes = len(about)
    config = SmolVLAConfig(
        input_features={
            "observation.state": PolicyFeature(FeatureType.STATE, (axes,)),
            **{f"observation.images.{name}": PolicyFeature(FeatureType.VISUAL, picture) for name in cameras},
        },
        output_features={"action": PolicyFeature(FeatureType.ACTION, (axes,))},
        vlm_model_name=str(folder / "vlm"),
        load_vlm_weights=False,
        num_vlm_layers=2,
        chunk_size=chunk,
        n_action_steps=chunk,
        num_steps=5,
        max_state_dim=8,
        max_action_dim=8,
        resize_imgs_with_padding=(SIZE, SIZE),
        device="cpu",
        push_to_hub=False,
    )
    checkpoint = folder / "checkpoint"
    SmolVLAPolicy(config).save_pretrained(checkpoint)
    figures = {"mean": torch.tensor(about), "std": torch.ones(axes)}
    stats = {"observation.state": figures, "action": figures}
    for processor in make_pre_post_processors(config, dataset_stats=stats):
        processor.save_pretrained(checkpoint)
    return checkpoint


def _save_vlm(folder: Path) -> None:
    from transformers import SmolVLMConfig, SmolVLMImageProcessor, SmolVLMProcessor, SmolVLMVideoProcessor

    text = {
        "model_type": "llama", "vocab_size": len(WORDS), "hidden_size": 64, "intermediate_size": 64,
        "num_hidden_layers": 2, "num_attention_heads": 4, "num_key_value_heads": 2, "head_dim": 16,
        "pad_token_id": 0,
    }  # fmt: skip
    vision = {
        "hidden_size": 32, "intermediate_size": 32, "num_hidden_layers": 1, "num_attention_heads": 2,
        "image_size": SIZE, "patch_size": 16,
    }  # fmt: skip
    SmolVLMConfig(text_config=text, vision_config=vision, scale_factor=2, image_token_id=2).save_pretrained(folder)
    tokenizer = _tokenizer()
    tokenizer.save_pretrained(folder)
    SmolVLMProcessor(SmolVLMImageProcessor(), tokenizer, SmolVLMVideoProcessor()).save_pretrained(folder)


def _tokenizer() -> Any:
    from tokenizers import Tokenizer, models, pre_tokenizers
    from transformers import PreTrainedTokenizerFast

    words = Tokenizer(models.WordLevel({word: at for at, word in enumerate(WORDS)}, unk_token="<unk>"))
    words.pre_tokenizer = pre_tokenizers.WhitespaceSplit()
    special = {
        "image_token": "<image>", "fake_image_token": "<fake_token_around_image>",
        "global_image_token": "<global-img>", "end_of_utterance_token": "<end_of_utterance>",
    }  # fmt: skip
    return PreTrainedTokenizerFast(
        tokenizer_object=words, pad_token="<pad>", unk_token="<unk>", extra_special_tokens=special
    )
