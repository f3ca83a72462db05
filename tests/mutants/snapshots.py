"""Snapshots that lose something."""

from __future__ import annotations

from typing import Any, ClassVar

from orbit_torch.engine import TorchEngine

from .mutant import mutant

COMMANDS = "snapshots::test_a_snapshot_holds_commands"
PARAMETERS = "snapshots::test_a_snapshot_holds_what_was_set_per_environment"
REPEATS = "snapshots::test_a_snapshot_repeats"


class _Forgetful(TorchEngine):
    """Leaves some of the state out."""

    lost: ClassVar[tuple[str, ...]]

    def load_state(self, state: Any) -> None:
        super().load_state({name: values for name, values in state.items() if name not in self.lost})


@mutant(COMMANDS)
class PositionTargetsLost(_Forgetful):
    """Saves no position targets."""

    lost = ("position_targets",)


@mutant(COMMANDS)
class VelocityTargetsLost(_Forgetful):
    """Saves no velocity targets."""

    lost = ("velocity_targets",)


@mutant(COMMANDS, "snapshots::test_a_snapshot_continues_under_its_commands")
class EffortsLost(_Forgetful):
    """Saves no efforts."""

    lost = ("efforts",)


@mutant("snapshots::test_a_snapshot_holds_the_efforts_of_the_last_step")
class EffortReadingsLost(_Forgetful):
    """Tells, after loading, the efforts of the step before loading."""

    lost = ("_applied",)


@mutant("snapshots::test_a_snapshot_holds_contact_forces")
class ContactReadingsLost(_Forgetful):
    """Tells, after loading, the contact forces of the step before loading."""

    lost = ("_contact_forces",)


@mutant(REPEATS)
class VelocitiesLost(_Forgetful):
    """Saves no velocities of links."""

    lost = ("_velocities",)


@mutant(REPEATS)
class JointRatesLost(_Forgetful):
    """Saves no velocities of joints."""

    lost = ("_rates",)


@mutant(REPEATS)
class WarmStartsLost(_Forgetful):
    """Saves no impulses that the solver begins with."""

    lost = ("_stopping", "_touching")


@mutant(PARAMETERS)
class MassesLost(_Forgetful):
    """Saves no masses."""

    lost = ("_masses",)


@mutant(PARAMETERS)
class CentresOfMassLost(_Forgetful):
    """Saves no centres of mass."""

    lost = ("_centers",)


@mutant(PARAMETERS)
class FrictionLost(_Forgetful):
    """Saves no friction."""

    lost = ("_friction",)


@mutant(PARAMETERS)
class GainsLost(_Forgetful):
    """Saves no drive gains."""

    lost = ("_stiffness", "_drive_damping")


@mutant(PARAMETERS)
class GravityLost(_Forgetful):
    """Saves no gravity."""

    lost = ("_gravity",)


@mutant(PARAMETERS)
class WrenchesLost(_Forgetful):
    """Saves no external wrenches."""

    lost = ("_wrenches",)


@mutant(REPEATS, COMMANDS)
class SnapshotsThatMoveOn(TorchEngine):
    """Hands out its own memory as a snapshot."""

    def save_state(self) -> Any:
        return {name: getattr(self, name) for name in super().save_state()}
