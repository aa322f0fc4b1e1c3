"""Which policy an argument of ``run`` means, and what a folder holds. Nothing is loaded here."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from strands_actors.policies.lerobot import FILES
from strands_actors.policies.sources import Kind, choose


def checkpoint(folder: Path) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    for name in FILES:
        (folder / name).write_text("{}")
    return folder


def test_a_checkpoint_of_lerobot_is_a_folder_by_text_path_and_home(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = checkpoint(tmp_path / "act")
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.chdir(tmp_path)
    for given in (str(folder), folder, "~/act", "act", "./act"):
        source = choose(given, {"units": "degrees"})
        assert (source.kind, source.provider, source.hz) == (Kind.FOLDER, "lerobot_local", None)
        assert source.options == {"units": "degrees", "pretrained_name_or_path": str(folder)}


def test_a_name_comes_before_a_folder_of_that_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    checkpoint(tmp_path / "mock")
    monkeypatch.chdir(tmp_path)
    assert choose("mock", {"amplitude": 1.0})[:5] == (Kind.NAME, "mock", None, "mock", {"amplitude": 1.0})
    assert choose("./mock", {}).kind is Kind.FOLDER
    assert choose("pkg.module:Class", {}).kind is Kind.NAME
    assert choose("ws://gpu:8765", {}).kind is Kind.SERVER


@pytest.mark.parametrize("name", ["model.pt", "weights.PTH", "actor.pkl", "pytorch_model.bin", "epoch.ckpt"])
def test_a_pickle_is_refused_with_how_to_convert_it(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_bytes(b"cos\nsystem\n(S'false'\ntR.")
    (tmp_path / "config.json").write_text("{}")
    for given in (tmp_path, tmp_path / name):
        with pytest.raises(ValueError, match=r"in Python's pickle format.*Convert it.*safetensors") as refusal:
            choose(given, {})
        assert name in str(refusal.value)


def test_a_folder_without_a_policy_names_what_fits(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="holds no policy \\(no files\\)"):
        choose(tmp_path, {})
    inner = checkpoint(tmp_path / "checkpoints" / "last" / "pretrained_model")
    with pytest.raises(ValueError, match=f"is a training folder of lerobot. Give its checkpoint: {inner}"):
        choose(tmp_path, {})
    (inner / FILES[2]).unlink()
    with pytest.raises(ValueError, match=f"has no {FILES[2]}"):
        choose(inner, {})


@pytest.mark.parametrize(
    ("policy", "options", "error", "text"),
    [
        ("/nowhere/at/all", {}, ValueError, "there is no folder /nowhere/at/all"),
        (__file__, {}, ValueError, "is a file. Give the folder"),
        ("grpc://gpu", {}, ValueError, "there is no client for grpc://"),
        ("", {}, ValueError, "is no policy's name"),
        ("\x1b[2J", {}, ValueError, "is no policy's name"),
        ("x" * 5000, {}, ValueError, "is no policy's name"),
        ("/" + "x" * 5000, {}, ValueError, "there is no folder"),
        (None, {}, TypeError, "policy is None"),
        ({"step": 1}, {}, TypeError, "dict is no policy"),
        (print, {"units": "degrees"}, TypeError, "units: of a policy that is made already"),
    ],
)
def test_a_wrong_argument_is_refused_by_name(
    policy: Any, options: dict[str, Any], error: type[Exception], text: str
) -> None:
    with pytest.raises(error, match=text):
        choose(policy, options)


def test_a_folder_sets_its_own_path(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="pretrained_name_or_path: the folder sets it"):
        choose(checkpoint(tmp_path), {"pretrained_name_or_path": "/other"})
