"""Undo and redo: documents are immutable, so that a step back is the document before."""

from __future__ import annotations

from dataclasses import dataclass

from orbit_scenes.document.model import SceneDocument

# Documents share all that did not change: a step costs the few objects that did.
_MOST = 500


@dataclass(frozen=True)
class Step:
    """A document, and the edit that made it."""

    label: str
    """The edit in words, such as "move mug"."""
    document: SceneDocument
    """Document after the edit."""


class History:
    """Document that is edited, with the steps that led to it and those that were taken back.

    Args:
        document: the first one.
    """

    def __init__(self, document: SceneDocument) -> None:
        self._done = [Step("", document)]
        self._undone: list[Step] = []
        self._saved: SceneDocument | None = document

    @property
    def document(self) -> SceneDocument:
        """Document as it now is."""
        return self._done[-1].document

    @property
    def undo_label(self) -> str:
        """Edit that :meth:`undo` takes back; empty if there is none."""
        return self._done[-1].label if len(self._done) > 1 else ""

    @property
    def redo_label(self) -> str:
        """Edit that :meth:`redo` makes again; empty if there is none."""
        return self._undone[-1].label if self._undone else ""

    @property
    def saved(self) -> bool:
        """True if the document is the one that was saved last."""
        return self.document == self._saved

    def do(self, label: str, document: SceneDocument, merge: bool = False) -> bool:
        """Take an edit's result as the document; return False if it changes nothing.

        Args:
            label: the edit in words.
            document: result of the edit.
            merge: make one step of this edit and the last, if that has the same label: a number that is typed digit by
                digit is one edit to a person.
        """
        if document == self.document:
            return False
        if merge and self.undo_label == label and not self._undone:
            self._done.pop()
        self._done.append(Step(label, document))
        self._undone.clear()
        if len(self._done) > _MOST:
            del self._done[0]
        return True

    def undo(self) -> str:
        """Take the last edit back; return its label, empty if there is none."""
        if len(self._done) == 1:
            return ""
        self._undone.append(self._done.pop())
        return self._undone[-1].label

    def redo(self) -> str:
        """Make the edit again that was taken back last; return its label, empty if there is none."""
        if not self._undone:
            return ""
        self._done.append(self._undone.pop())
        return self._done[-1].label

    def mark_saved(self, saved: bool = True) -> None:
        """Note that the document as it now is has been saved, or that no file holds it."""
        self._saved = self.document if saved else None
