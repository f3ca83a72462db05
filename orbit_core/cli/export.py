"""``orbit export``: a learned policy for use without ORBIT."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from orbit_core.cli.output import console
from orbit_core.cli.parsing import parse_words
from orbit_core.pretrained import policy_path


@dataclass(frozen=True, kw_only=True)
class ExportSettings:
    """Write a learned policy as safetensors and ONNX, with the description of observation and action beside them."""

    policy: Annotated[Positional[Path], arg(metavar="POLICY")]
    """File policy_<iteration>.safetensors, the folder of a training, which stands for its last, or a kept policy's name
    ('orbit list policies')."""
    output: Annotated[Path, arg(metavar="FOLDER")] = Path("out/policy")
    """Takes policy.safetensors, policy.onnx and policy.json."""


def main(words: Sequence[str]) -> None:
    """Write the three files."""
    from orbit_core.learning.policy import load_policy

    settings = parse_words(ExportSettings, words, "orbit export")
    policy = load_policy(policy_path(settings.policy))
    settings.output.mkdir(parents=True, exist_ok=True)
    policy.save(settings.output / "policy.safetensors")
    (settings.output / "policy.json").write_text(json.dumps(policy.description.document()["policy"], indent=2) + "\n")
    policy.export_onnx(settings.output / "policy.onnx")
    console().print(f"policy.safetensors, policy.onnx and policy.json are in {settings.output}")
