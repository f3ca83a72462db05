"""Library in the panel: entries of the catalogue with search and pictures, each with a button that adds it."""

from __future__ import annotations

import base64
import html
import io
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from orbit_core.interfaces.errors import OrbitError
from orbit_scenes.editor.catalogue import Entry, Group, search
from orbit_scenes.editor.pictures import THUMBNAIL, Picture, thumbnail

if TYPE_CHECKING:
    from viser import ViserServer

PAGE = 6
"""Entries that are shown at a time: each picture is sent to the browser."""
ALL = "Everything"
"""Choice of all headings."""


class Library:
    """Search and results; results are rows of a picture, words and a button, which are reused.

    Args:
        server: viser's server; inputs are added to the current container.
        renderer: name of what draws pictures that the cache lacks.
        add: adds an entry to the scene; called in another thread.
        wake: wakes the editor's thread, which draws pictures.
    """

    def __init__(
        self, server: ViserServer, renderer: str, add: Callable[[Entry], None], wake: Callable[[], None]
    ) -> None:
        self._renderer, self._add, self._wake = renderer, add, wake
        gui = server.gui
        self._query = gui.add_text("Search", "", hint="Words of a name, or a composition such as ur10+robotiq_2f85")
        self._group = gui.add_dropdown("Of", (ALL, *(group.value for group in Group)), initial_value=ALL)
        self._first = 0
        self._found: tuple[Entry, ...] = ()
        self._rows: list[tuple[Any, Any]] = []
        self._pictures: dict[Entry, Picture | None] = {}
        for index in range(PAGE):
            row = gui.add_html("", visible=False)
            button = gui.add_button("Add", color="gray", visible=False)
            button.on_click(lambda _, index=index: self._press(index))
            self._rows.append((row, button))
        self._count = gui.add_markdown("")
        pages = gui.add_button_group("Page", ("Before", "Next"))
        self._query.on_update(lambda _: self._begin())
        self._group.on_update(lambda _: self._begin())
        pages.on_click(lambda _: self._turn(pages.value))
        self._begin()

    @property
    def shown(self) -> tuple[Entry, ...]:
        """Entries on the present page."""
        return self._found[self._first : self._first + PAGE]

    def draw_next(self) -> bool:
        """Draw one picture that the page lacks; return False if it lacks none. For the editor's thread."""
        for entry in self.shown:
            if entry not in self._pictures:
                try:
                    self._pictures[entry] = thumbnail(entry, self._renderer)
                except OrbitError:
                    # What cannot be drawn here can still be added, where the error is shown.
                    self._pictures[entry] = None
                self._show()
                return True
        return False

    def _press(self, index: int) -> None:
        if index < len(self.shown):
            self._add(self.shown[index])

    def _begin(self) -> None:
        group = next((each for each in Group if each.value == self._group.value), None)
        self._found, self._first = search(self._query.value[:80], group), 0
        self._show()
        self._wake()

    def _turn(self, way: str) -> None:
        first = self._first + (PAGE if way == "Next" else -PAGE)
        if 0 <= first < len(self._found):
            self._first = first
            self._show()
            self._wake()

    def _show(self) -> None:
        shown = self.shown
        for index, (row, button) in enumerate(self._rows):
            row.visible = button.visible = index < len(shown)
            if index < len(shown):
                entry = shown[index]
                row.content = _card(entry, self._pictures.get(entry))
                button.label = f"Add {entry.name}"
        last = min(self._first + PAGE, len(self._found))
        words = f"{self._first + 1} to {last} of {len(self._found)}" if self._found else "nothing found"
        self._count.content = f"*{words}*"


def _card(entry: Entry, picture: Picture | None) -> str:
    """Return a row of HTML; names come from installed packages and are escaped all the same."""
    width, height = THUMBNAIL[0] * 3 // 4, THUMBNAIL[1] * 3 // 4
    if picture is None:
        box = f"<div style='width:{width}px;height:{height}px;background:#8882;border-radius:4px;flex:none'></div>"
    else:
        data = base64.b64encode(_png(picture)).decode()
        box = (
            f"<img src='data:image/png;base64,{data}' width='{width}' height='{height}' "
            f"style='border-radius:4px;flex:none' alt='{html.escape(entry.name, quote=True)}'>"
        )
    words = html.escape(entry.words)
    return (
        f"<div style='display:flex;gap:10px;align-items:center;padding:6px 10px'>{box}"
        f"<div style='font-size:12px;line-height:1.35;min-width:0;overflow-wrap:anywhere'>"
        f"<b>{html.escape(entry.name)}</b><br>"
        f"{words if len(words) < 90 else words[:87] + '...'}</div></div>"
    )


def _png(picture: Picture) -> bytes:
    from PIL import Image

    file = io.BytesIO()
    Image.fromarray(picture).save(file, format="PNG")
    return file.getvalue()
