"""What a reader finds in a file besides what it keeps: faults, things that it leaves out, and remarks."""

from __future__ import annotations

from orbit_assets.options import ReadOptions, Unsupported
from orbit_core.interfaces.errors import AssetError

_MOST = 3
"""Places that a note lists; it counts the rest."""


class Findings:
    """Errors that name one file, and the notes on what was left out of it.

    Args:
        place: the file with its format, as "URDF file 'a.urdf'".
        options: says whether what ORBIT has no word for is refused or left out.
    """

    def __init__(self, place: str, options: ReadOptions) -> None:
        self.place = place
        self._drop = options.unsupported is Unsupported.DROP
        self._left_out: dict[str, list[str]] = {}
        self._notes: dict[str, None] = {}

    def error(self, fault: str, remedy: str) -> AssetError:
        """The error for a fault of the file, to be raised."""
        return AssetError(f"in {self.place}, {fault}: {remedy}")

    def note(self, text: str) -> None:
        """Remark something once, however often it is met."""
        self._notes[text] = None

    def leave_out(self, what: str, where: str) -> None:
        """Count something that changes no motion of the model, or that ORBIT keeps elsewhere, as left out."""
        self._left_out.setdefault(what, []).append(where)

    def unsupported(self, what: str, where: str, remedy: str) -> None:
        """Refuse something that the description cannot hold, or leave it out where the caller asked for that.

        Raises:
            AssetError: the caller did not ask for it.
        """
        if not self._drop:
            raise self.error(
                f"{where} has {what}, which ORBIT does not have",
                f"{remedy}, or leave it out by ReadOptions(unsupported=Unsupported.DROP)",
            )
        self.leave_out(what, where)

    @property
    def notes(self) -> tuple[str, ...]:
        """Everything remarked and left out, in the order met."""
        left_out = (f"{what} is left out of {_listed(where)}" for what, where in self._left_out.items())
        return (*self._notes, *left_out)


def _listed(places: list[str]) -> str:
    distinct = list(dict.fromkeys(places))
    if len(distinct) <= _MOST:
        return ", ".join(distinct)
    return f"{', '.join(distinct[:_MOST])} and {len(distinct) - _MOST} more"
