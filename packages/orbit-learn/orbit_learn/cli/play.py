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
    """Return the settings with all that the policy was learned for in the place of what they leave open.

    Raises:
        UnknownNameError: there is no such file, folder or kept policy.
        ConfigurationError: it is no policy.
    """
    return restored_settings(settings).settings


def restored_settings(settings: PlaySettings) -> Restored:
    """As :func:`played`, with what differs from the training. Of a kept policy ``policy.toml`` says the fields.

    Raises:
        UnknownNameError: there is no such file, folder or kept policy.
        ConfigurationError: it is no policy, or the file beside it is no record of a training.
    """
    from orbit_learn.policy import load_policy

    path = policy_path(settings.policy)
    learned = load_policy(path).description
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
