"""``orbit export``: a learned policy for use without ORBIT."""

from __future__ import annotations

import dataclasses
import json
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import Positional, arg

from orbit_core.backends import backend_names
from orbit_core.cli.making import make_environment
from orbit_core.cli.output import console
from orbit_core.cli.parsing import parse_words
from orbit_core.cli.settings import EnvironmentSettings
from orbit_core.files import storage_faults
from orbit_core.interfaces.errors import OrbitError
from orbit_core.pretrained import policy_fields, policy_path

if TYPE_CHECKING:
    from orbit_core.data.manifest import Manifest
    from orbit_core.learning.policy import Policy


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
    if policy.manifest is None:
        policy = dataclasses.replace(policy, manifest=_present(policy, settings.policy))
    with storage_faults(settings.output):
        settings.output.mkdir(parents=True, exist_ok=True)
        described = json.dumps(policy.description.document()["policy"], indent=2)
        (settings.output / "policy.json").write_text(described + "\n", encoding="utf-8")
    policy.save(settings.output / "policy.safetensors")
    policy.export_onnx(settings.output / "policy.onnx")
    console().print(f"policy.safetensors, policy.onnx and policy.json are in {settings.output}", soft_wrap=True)


def _present(policy: Policy, path: Path) -> Manifest | None:
    """The manifest of the environment that a policy fits today, for files of before there were manifests."""
    from orbit_core.data.compare import renamed_group
    from orbit_core.data.manifest import Manifest

    learned = policy.description
    installed = learned.backend in backend_names()
    made = EnvironmentSettings(
        task=learned.task,
        robot=learned.robot,
        action=learned.action,
        backend=learned.backend if installed else None,
        fields=policy_fields(path),
    )
    try:
        environment = make_environment(made, 1)
        try:
            group = policy.fit(environment)
            manifest = renamed_group(Manifest.of(environment, learned.task, made.seed), group, learned.group)
        finally:
            environment.close()
    except OrbitError as error:
        warnings.warn(f"the files hold no manifest: that of {path} has none, and {error}", stacklevel=2)
        return None
    warnings.warn(
        f"{path} holds no manifest of where it was learned: the files get that of its environment as it is today, on "
        f"{manifest.backend}",
        stacklevel=2,
    )
    return manifest
