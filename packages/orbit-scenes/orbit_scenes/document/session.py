"""Editing session of one scene file: document with history, autosaved after each edit, one session at a time."""

from __future__ import annotations

import fcntl
import os
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from orbit_core.configuration import read_toml
from orbit_core.files import storage_faults, sweep
from orbit_core.interfaces.errors import ConfigurationError, OrbitError
from orbit_scenes.document.build import SceneBuilder
from orbit_scenes.document.files import SCENE_SUFFIXES, SUFFIX, document_of, load_document, save_document, save_usd
from orbit_scenes.document.history import History
from orbit_scenes.document.model import SceneDocument

RECOVERED = "recover what was not saved"
"""Label of the edit that brings back what a session that ended without saving had."""


class Session:
    """One person's work on a scene file.

    Edits that are not saved stand in a hidden file next to it, ``.NAME.autosave``, which the next session finds
    whatever ended this one.

    Args:
        path: TOML file, which need not be there yet; or a USD or MJCF file, whose scene becomes a TOML file of the
            same stem.

    Raises:
        ConfigurationError: the file is damaged, its folder is missing, or another session edits it.
        AssetError: a USD or MJCF file holds no scene.
    """

    def __init__(self, path: Path) -> None:
        whole = path.suffix.lower() in SCENE_SUFFIXES
        self.path = path.with_suffix(SUFFIX) if whole else path
        """TOML file that :meth:`save` writes."""
        if not self.path.parent.is_dir():
            raise ConfigurationError(f"there is no folder {self.path.parent}")
        if whole and self.path.exists():
            raise ConfigurationError(f"{self.path} is there already: edit that, or move it away to begin with {path}")
        # Before the lock: a file that cannot be read leaves nothing behind.
        begun = path.exists() or whole or path.suffix.lower() != SUFFIX
        document = load_document(path) if begun else SceneDocument()
        self._autosave = self.path.with_name(f".{self.path.name}.autosave")
        self._lock_path = self.path.with_name(f".{self.path.name}.lock")
        self._lock = self._locked()
        try:
            # Half-written files of a session that was killed; under the lock, so that none of a live one goes.
            sweep(self.path.parent)
            self.builder = SceneBuilder(self.path.parent)
            """Builder of the document's scene."""
            self.history = History(document)
            """The document, with undo and redo."""
            # A scene that was read from USD or MJCF is not in its own file before it is saved.
            if not self.path.exists():
                self.history.mark_saved(False)
            self.recovered = self._recover()
            """True if edits of a session that ended without saving were found; undo takes them back."""
        except OrbitError:
            self._unlock()
            raise

    @property
    def document(self) -> SceneDocument:
        """Document as it now is."""
        return self.history.document

    def do(self, label: str, edit: Callable[[SceneDocument], SceneDocument], merge: bool = False) -> bool:
        """Make an edit, if its result can be built; return False if it changes nothing.

        Args:
            label: the edit in words.
            edit: returns the changed document.
            merge: make one step of this edit and the last, if that has the same label.

        Raises:
            OrbitError: the result is no scene; the document stays as it was.
        """
        document = edit(self.document)
        # Refused here, where the person sees which edit it was, and not when physics starts.
        self.builder.scene(document)
        changed = self.history.do(label, document, merge)
        if changed:
            self._keep()
        return changed

    def undo(self) -> str:
        """Take the last edit back; return its label, empty if there is none."""
        label = self.history.undo()
        self._keep()
        return label

    def redo(self) -> str:
        """Make the edit again that was taken back last; return its label, empty if there is none."""
        label = self.history.redo()
        self._keep()
        return label

    def save(self) -> None:
        """Write the document to its file, whole or not at all.

        Raises:
            StorageError: the file cannot be written; the autosaved copy stays.
        """
        save_document(self.document, self.path)
        self.history.mark_saved()
        self._keep()

    def save_usd(self) -> tuple[Path, tuple[str, ...]]:
        """Write the scene next to the document's file as USD; return its path, and what it cannot hold.

        Raises:
            ConfigurationError: the document itself reads a file of that name.
            StorageError: the file cannot be written.
        """
        path = self.path.with_suffix(".usda")
        if path.name in {self.document.terrain, *(item.file for item in self.document.items)}:
            # The file is the source of items: to replace it would change them under the document.
            path = path.with_name(f"{path.stem}_edited.usda")
        return path, save_usd(self.document, self.builder, path)

    def close(self) -> None:
        """End the session; what is not saved stays autosaved. Idempotent."""
        self._unlock()

    def _keep(self) -> None:
        """Write what is not saved to the autosave file, or delete that file."""
        if self.history.saved:
            with storage_faults(self._autosave):
                self._autosave.unlink(missing_ok=True)
            return
        save_document(self.document, self._autosave)

    def _recover(self) -> bool:
        if not self._autosave.exists():
            return False
        try:
            found = document_of(read_toml(self._autosave, "autosaved scene"), f"autosaved scene {self._autosave}")
            self.builder.scene(found)
        except OrbitError as error:
            raise ConfigurationError(
                f"{error}; it holds what a session that was lost had not saved: fix it by hand, or delete it to "
                f"begin with {self.path}"
            ) from error
        # As an edit, so that undo leads to what was saved last.
        return self.history.do(RECOVERED, found)

    def _locked(self) -> int:
        with storage_faults(self._lock_path):
            lock = os.open(self._lock_path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o600)
        try:
            # The system drops the lock however the process ends, so that a killed one bars nobody.
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(lock)
            raise ConfigurationError(f"{self.path} is edited by another 'orbit edit': end that first") from None
        return lock

    def _unlock(self) -> None:
        if self._lock >= 0:
            # Before the lock is given up: another session must not find a file that then goes.
            with suppress(OSError):
                self._lock_path.unlink()
            os.close(self._lock)
            self._lock = -1
