"""``orbit play``: a learned policy's task, with the policy, on any backend."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

from orbit_core.cli.parsing import parse_settings
from orbit_core.cli.run import show_run
from orbit_core.cli.settings import PlaySettings
from orbit_core.pretrained import policy_fields, policy_path


def main(words: Sequence[str]) -> None:
    """Run the policy as ``orbit run`` runs an expert."""
    show_run(played(parse_settings(PlaySettings, words, "orbit play")))


def played(settings: PlaySettings) -> PlaySettings:
    """The settings with all that the policy was learned for in the place of what they leave open.

    Raises:
        UnknownNameError: there is no such file, folder or kept policy.
        ConfigurationError: it is no policy.
    """
    from orbit_core.learning.policy import load_policy

    learned = load_policy(policy_path(settings.policy)).description
    return dataclasses.replace(
        settings,
        task=settings.task or learned.task,
        robot=settings.robot or learned.robot,
        action=settings.action or learned.action,
        agent=str(settings.policy),
        fields={**policy_fields(settings.policy), **settings.fields},
    )
