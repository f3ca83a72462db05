"""``orbit export``: a learned policy for use without ORBIT."""

from __future__ import annotations

import dataclasses
import datetime
import json
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from tyro.conf import Positional, arg

from orbit_core.backends import backend_names
from orbit_core.cli.making import make_environment
from orbit_core.cli.output import console
from orbit_core.cli.settings import EnvironmentSettings, check_output, make_folder, parse_words
from orbit_core.files import check_apart, written_whole
from orbit_core.interfaces.errors import ConfigurationError, OrbitError
from orbit_learn.cli.trained import training_record
from orbit_learn.pretrained import policy_fields, policy_path

if TYPE_CHECKING:
    from orbit_data.manifest.manifest import Manifest
    from orbit_learn.policy import Policy

# Settings of a training that determine its environment's numbers, in addition to the policy's own description.
_OF_A_TRAINING = ("robot", "action", "fields", "set", "settings", "setting")


@dataclass(frozen=True, kw_only=True)
class ExportSettings:
    """Write a learned policy as safetensors and ONNX, with a description of observation and action."""

    policy: Annotated[Positional[Path], arg(metavar="POLICY")]
    """File policy_<iteration>.safetensors, the folder of a training (its last policy), or a kept policy's name
    ('orbit list policies')."""
    output: Annotated[Path, arg(metavar="FOLDER")] = Path("out/policy")
    """Folder for policy.safetensors, policy.onnx and policy.json."""
    runtime: Annotated[Path | None, arg(metavar="FOLDER")] = None
    """Write instead the policy for use without ORBIT into this folder: policy.onnx, runtime.json and orbit_runtime.py
    for NumPy and onnxruntime, orbit_runtime.hpp and orbit_policy.hpp for C++17."""
    overwrite: bool = False
    """Replace existing files of those names."""
    amend: bool = False
    """Export nothing, but add the missing manifest to the policy's own file, which is older than manifests."""


def main(words: Sequence[str]) -> None:
    """Write the three files, or the manifest into the policy's own."""
    from orbit_learn.policy import load_policy

    settings = parse_words(ExportSettings, words, "orbit export")
    path = policy_path(settings.policy)
    policy = load_policy(path)
    if settings.amend:
        return _amend(policy, path)
    if settings.runtime is not None:
        return _export_runtime(settings, policy, path)
    described, weights, onnx = (settings.output / f"policy{suffix}" for suffix in (".json", ".safetensors", ".onnx"))
    make_folder(described)
    for target in (described, weights, onnx):
        # Exporting a policy onto itself would replace the file that is read.
        check_apart(target, [path] if path.is_file() else [])
        check_output(target, target.suffix, settings.overwrite)
    if policy.manifest is None:
        try:
            policy = dataclasses.replace(policy, manifest=_present(policy, path))
            outcome = f"the files get that of its environment as it is today, on {policy.description.backend}"
        except OrbitError as error:
            outcome = f"the files have none either: {error}"
        warnings.warn(f"{path} holds no manifest of where it was learned: {outcome}", stacklevel=2)
    elif not policy.manifest.explains:
        policy = dataclasses.replace(policy, manifest=_explained(policy, policy.manifest, path))
    manifest = {} if policy.manifest is None else {"manifest": policy.manifest.document()}
    document = json.dumps({**policy.description.document()["policy"], **manifest}, indent=2)
    # All three are written before the first takes its place, so that they belong to one policy even after an error.
    with written_whole(described) as text, written_whole(weights) as tensors, written_whole(onnx) as graph:
        text.write_text(document + "\n", encoding="utf-8")
        policy.save(tensors)
        policy.export_onnx(graph)
    console().print(f"policy.safetensors, policy.onnx and policy.json are in {settings.output}", soft_wrap=True)
    return None


def _export_runtime(settings: ExportSettings, policy: Policy, path: Path) -> None:
    from orbit_data.manifest.manifest import Manifest, renamed_group
    from orbit_learn.runtime import NAMES, write_runtime

    folder = settings.runtime
    assert folder is not None, "the caller has looked"
    targets = [folder / name for name in NAMES]
    make_folder(targets[0])
    for target in targets:
        check_apart(target, [path] if path.is_file() else [])
        check_output(target, target.suffix, settings.overwrite)
    environment = make_environment(_settings_of(policy, path)[0], 1)
    try:
        # Of the environment as it is today, which describes all its numbers; the policy's own is compared with it.
        group = policy.fit(environment)
        manifest = renamed_group(Manifest.of(environment, policy.description.task, 0), group, policy.description.group)
        write_runtime(folder, policy, manifest, environment)
    finally:
        environment.close()
    console().print(
        f"{', '.join(NAMES)} are in {folder}: Python needs numpy and onnxruntime, C++ a network such as onnxruntime's",
        soft_wrap=True,
    )


def _amend(policy: Policy, path: Path) -> None:
    from orbit_data.tensor_file import read_tensors, write_tensors
    from orbit_learn.policy_file import manifest_document, newest_file

    file = newest_file(path, "policy") if path.is_dir() else path
    assert file is not None, "it was read"
    if policy.manifest is not None:
        raise ConfigurationError(f"{file} holds a manifest already: '--amend' is for files that have none")
    if policy.network is None:
        raise ConfigurationError(f"'--amend' writes into safetensors files alone, not into {file}")
    document, tensors = read_tensors(file)
    write_tensors(file, {**document, **manifest_document(_present(policy, path))}, tensors)
    console().print(f"{file} holds the manifest of its environment as it is today", soft_wrap=True)


def _explained(policy: Policy, recorded: Manifest, path: Path) -> Manifest:
    """Complete a manifest that does not describe its numbers by that of today's environment.

    Args:
        policy: policy of the manifest.
        recorded: manifest that is completed.
        path: path of the policy.

    Returns:
        The completed manifest if the environment has the same joints, home positions and terms; otherwise the manifest
        as it was, with a warning.
    """
    from orbit_data.manifest.manifest import Kind, differences

    group = policy.description.group
    try:
        present = _present(policy, path)
        found = differences(recorded, present, [group])
        wrong = [str(each) for each in found if each.kind is Kind.ERROR or each.path.endswith("home_positions")]
        if not wrong:
            return dataclasses.replace(recorded, observations={group: recorded.observations[group]}).explained_by(
                present
            )
        reason = "; ".join(wrong)
    except OrbitError as error:
        reason = str(error)
    warnings.warn(f"{path} does not say what its numbers mean, nor does its environment today: {reason}", stacklevel=3)
    return recorded


def _present(policy: Policy, path: Path) -> Manifest:
    """Return the manifest of the environment that a policy fits today, for files that are older than manifests.

    Facts of the training's record next to the file are included.

    Raises:
        OrbitError: the environment cannot be made here.
    """
    from orbit_data.manifest.manifest import Manifest, renamed_group

    made, training = _settings_of(policy, path)
    learned = policy.description
    environment = make_environment(made, 1)
    try:
        group = policy.fit(environment)
        manifest = renamed_group(Manifest.of(environment, learned.task, made.seed), group, learned.group)
    finally:
        environment.close()
    # These do not change what numbers mean, so that the training's own values are more true than today's.
    known = {key: training["settings"][key] for key in ("seed", "num_envs", "device") if training}
    known |= {"versions": training["versions"]} if training else {}
    of = f"; {', '.join(known)} and settings are those that its training recorded" if known else ""
    on = datetime.datetime.now(tz=datetime.UTC).date().isoformat()
    later = f"on {on}, of the environment that the policy fitted on that day{of}"
    return Manifest.decode(dataclasses.replace(manifest, **known, made_later=later).encode(), f"training of {path}")


def _settings_of(policy: Policy, path: Path) -> tuple[EnvironmentSettings, Mapping[str, Any]]:
    """Return settings of the environment that a policy fits today, and its training's record, which may be empty."""
    learned, training = policy.description, training_record(path)
    # A policy of a backend that is not installed gets the manifest of the default one.
    installed = learned.backend in backend_names()
    trained = {key: value for key in _OF_A_TRAINING if (value := training.get("settings", {}).get(key)) and installed}
    made = EnvironmentSettings(
        **{
            **trained,
            "task": learned.task,
            "robot": learned.robot,
            "action": learned.action,
            "backend": learned.backend if installed else None,
            "fields": {**trained.get("fields", {}), **policy_fields(path)},
        }
    )
    return made, training
