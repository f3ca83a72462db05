"""Policies that would compute too much, or hold a manifest or weights that cannot be."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
from onnx import helper

from orbit_core.interfaces import ConfigurationError
from orbit_learn.description import Part
from orbit_learn.networks import Convolutional, Picture, PictureEncoder
from orbit_learn.policy import Policy, load_policy
from tests.learning.test_bad_policy_files import DESCRIPTION, PRODUCT, changed, constant, model, put, saved, weight


@pytest.mark.parametrize("value", [None, 5, "text", [], {}, {"format": 1}, {"format": [1]}])
def test_a_policy_whose_manifest_is_none_is_refused(value: Any, tmp_path: Path) -> None:
    path = saved(tmp_path)
    changed(path, put("manifest", value=value))
    with pytest.raises(ConfigurationError, match=r"holds no manifest|manifest of format"):
        load_policy(path)


def test_complex_weights_are_not_taken_for_real_ones(tmp_path: Path) -> None:
    path = saved(tmp_path)
    changed(path, weight("mean", torch.ones(3, dtype=torch.complex64)))
    with pytest.raises(ConfigurationError, match="holds complex numbers in 'mean'"):
        load_policy(path)


def test_a_policy_that_computes_too_much_is_refused(tmp_path: Path) -> None:
    doubled = [helper.make_node("Identity", ["observation"], ["x0"])]
    doubled += [helper.make_node("Concat", [f"x{i}"] * 2, [f"x{i + 1}"], axis=1) for i in range(22)]
    many = [*doubled, *(helper.make_node("Tanh", ["x22"], [f"y{i}"]) for i in range(50))]
    square = [helper.make_node("Concat", ["observation"] * 1000, ["x"], axis=1)]
    square += [helper.make_node("Gemm", ["x", "x"], ["k0"], transA=1)]
    square += [helper.make_node("MatMul", [f"k{i}"] * 2, [f"k{i + 1}"]) for i in range(5)]
    for name, nodes, message in (
        ("many.onnx", many, "more than 67,108,864 numbers"),
        ("square.onnx", square, "more than 34,359,738,368 multiplications"),
    ):
        (tmp_path / name).write_bytes(model(*nodes, PRODUCT, weights=(constant("w", 3, 2),)))
        with pytest.raises(ConfigurationError, match=message):
            load_policy(tmp_path / name)
    picture = Part("camera", 1024 * 1024, (1024, 1024, 1), "uint8")
    encoder = PictureEncoder((Picture("camera", 1),), 1024, 1024, (512, 2, 2, 2, 2, 2, 2, 2), 4)
    network = Convolutional((encoder,), (), (4,))
    large = replace(DESCRIPTION, observation_parts=(picture,), concatenated=False)
    Policy(network.build(large.observation_size, 2), network, large).save(tmp_path / "large.safetensors")
    with pytest.raises(ConfigurationError, match="more than 67,108,864 numbers"):
        load_policy(tmp_path / "large.safetensors")
