"""``orbit edit``: author a scene in the browser."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from orbit_core.backends import backend, backend_names, default_backend
from orbit_core.cli.settings import check_port, parse_words
from orbit_core.installing import install_command
from orbit_core.interfaces.errors import ConfigurationError


@dataclass(frozen=True, kw_only=True)
class EditSettings:
    """Author a scene in the browser: robots, objects, furniture, sensors, light, and a task in it."""

    scene: Annotated[Positional[Path], arg(metavar="SCENE")]
    """Scene file, .toml, made by the first save; or a USD or MJCF file, whose scene is saved as .toml next to it."""
    backend: Annotated[str | None, arg(metavar="NAME")] = None
    """Engine that is chosen at first; the page offers all that are installed."""
    renderer: Annotated[str | None, arg(metavar="NAME")] = None
    """Renderer, or backend, of pictures; the engine if it draws, else the first backend that does."""
    host: str = "127.0.0.1"
    """Address to listen on; at any other than this computer's own, the printed address holds a token."""
    port: int = 8080
    """Port to listen on; the next free one if it is taken."""


def main(words: Sequence[str]) -> None:
    """Serve the editor until it is interrupted."""
    settings = parse_words(EditSettings, words, "orbit edit")
    check_port("port", settings.port)
    names = backend_names()
    if not names:
        default_backend()  # raises, with commands that install one
    first = settings.backend or (default_backend() if len(names) == 1 else names[0])
    backend(first)
    try:
        import orbit_viewer  # noqa: F401
    except ImportError:
        raise ConfigurationError(
            f"the editor needs the distribution orbit-viewer: {install_command('orbit-viewer')}"
        ) from None
    from orbit_scenes.document.session import Session
    from orbit_scenes.editor.editor import Editor
    from orbit_scenes.editor.pictures import drawing_name

    renderer = drawing_name(settings.renderer or first)
    session = Session(settings.scene)
    try:
        ordered = [first, *(name for name in names if name != first)]
        with Editor(session, ordered, renderer, settings.host, settings.port) as editor:
            if session.recovered:
                print(f"recovered edits of {session.path} that were not saved; undo goes back to the file", flush=True)
            print(f"edit at {editor.url}", flush=True)
            editor.run()
        if not session.history.saved:
            print(f"not saved: 'orbit edit {session.path}' goes on from here", flush=True)
    finally:
        session.close()
