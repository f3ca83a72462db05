"""``orbit play``: a learned policy's task, with the policy, on any backend."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

from orbit_core.cli.output import console
from orbit_core.cli.run import show_run
from orbit_core.cli.settings import parse_settings
from orbit_learn.cli.trained import PlaySettings, Restored, restore, training_record
from orbit_learn.pretrained import is_kept, policy_fields, policy_path


def main(words: Sequence[str]) -> None:
    """Run the policy as ``orbit run`` runs an expert, and print what differs from its training."""
    restored = restored_settings(parse_settings(PlaySettings, words, "orbit play"))
    for line in restored.differences:
        console().print(f"other than in training: {line}", soft_wrap=True, highlight=False, markup=False)
    show_run(restored.settings)


def played(settings: PlaySettings) -> PlaySettings:
    """Complete the settings by those that the policy was trained with.

    Raises:
        UnknownNameError: the file, folder or kept policy does not exist.
        ConfigurationError: the file is not a policy.
    """
    return restored_settings(settings).settings


def restored_settings(settings: PlaySettings) -> Restored:
    """Complete the settings as :func:`played`, and list the differences from the training.

    The fields of a kept policy come from ``policy.toml``.

    Raises:
        UnknownNameError: the file, folder or kept policy does not exist.
        ConfigurationError: the file is not a policy, or the training's record next to it is invalid.
    """
    from orbit_learn.policy import load_policy

    path = policy_path(settings.policy)
    learned = load_policy(path).description
    # A kept policy is played as its policy.toml states, even if the training's record is next to it.
    record = {} if is_kept(path) else training_record(path).get("settings", {})
    restored = restore(settings, record, settings.task or learned.task)
    own = restored.settings
    full = dataclasses.replace(
        own,
        task=own.task or learned.task,
        robot=own.robot or learned.robot,
        action=own.action or learned.action,
        agent=str(settings.policy),
        fields={**policy_fields(settings.policy), **own.fields},
    )
    return dataclasses.replace(restored, settings=full)
