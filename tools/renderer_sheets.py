"""Draw every task with every renderer, a sheet of small pictures for each, and write docs/renderers.md.

    python tools/renderer_sheets.py [--only NAME ...] [--folder FOLDER]

A task is simulated on MuJoCo once, as for the gallery, and drawn by each renderer at the same moment. ``--only`` draws
these tasks, and writes no page.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any

import tyro
from PIL import Image, ImageDraw
from task_gallery import DOCS, in_the_midst

from orbit_core import backends
from orbit_core.envs import task_entries
from orbit_core.envs.environment import Environment
from orbit_core.rollout.pictures import Spectator
from orbit_core.scene import STUDIO

PAGE, SHEETS = DOCS / "renderers.md", DOCS / "images" / "renderers"
WIDTH, HEIGHT, LABEL = 160, 120, 14
COLUMNS = 7


@dataclass(frozen=True)
class Drawn:
    """A renderer as one sheet shows it."""

    title: str
    """Title of its section."""
    renderer: str
    """Name of the renderer."""
    text: str
    """Description of what draws."""
    settings: dict[str, Any] = field(default_factory=dict)
    """Settings of the renderer."""


RENDERERS = {
    "mujoco": Drawn("MuJoCo", "mujoco", "MuJoCo's OpenGL renderer.", {"antialiasing": 4, "shadow_size": 4096}),
    "warp": Drawn("Warp", "warp", "Rays of MuJoCo-Warp; on a GPU, all environments in one launch."),
    "bullet-tiny": Drawn("Bullet in software", "bullet", "Bullet's TinyRenderer.", {"renderer": "tiny"}),
    "bullet-egl": Drawn("Bullet with OpenGL", "bullet", "Bullet's OpenGL renderer.", {"renderer": "egl"}),
    "sapien-fast": Drawn("SAPIEN, fast", "sapien-fast", "SAPIEN's rasteriser, in the scene's own law of light."),
    "sapien-pbr": Drawn("SAPIEN, physically based", "sapien-pbr", "SAPIEN's rasteriser, with highlights and metals."),
}
"""Renderers by the name of their sheet."""


@dataclass(frozen=True, kw_only=True)
class SheetSettings:
    """Draw every task with every renderer."""

    only: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME...")] = ()
    """Draw these tasks, and write no page."""
    folder: Path = SHEETS
    """Folder of the sheets."""


def main(settings: SheetSettings) -> None:
    """Draw the sheets, and write the page."""
    names = settings.only or tuple(task_entries())
    pictures: dict[str, list[Image.Image]] = {sheet: [] for sheet in RENDERERS}
    settings.folder.mkdir(parents=True, exist_ok=True)
    for number, name in enumerate(names):
        environment = in_the_midst(name)
        for sheet, drawn in RENDERERS.items():
            pictures[sheet].append(draw(environment, drawn))
            # Saved after each task: a run of all takes long, and what is drawn may be looked at.
            drawn_so_far = labelled(names[: number + 1], pictures[sheet])
            drawn_so_far.save(settings.folder / f"{sheet}.webp", quality=82, method=6)
        environment.close()
        print(name, flush=True)
    if not settings.only:
        PAGE.write_text(page(), encoding="utf-8")


def draw(environment: Environment, drawn: Drawn) -> Image.Image:
    """Return a spectator's picture of the environment by a renderer."""
    world: Any = environment.world
    plugin = backends.renderer(drawn.renderer)
    # A world has one renderer; taking its place for a picture saves five worlds a task.
    world._renderer_plugin, world._renderer_config = plugin, backends.backend_config(plugin, drawn.settings)
    camera = Spectator(environment, WIDTH, HEIGHT, studio=replace(STUDIO, samples=4))
    picture = Image.fromarray(camera.pictures()[0].numpy())
    camera.close()
    return picture


def labelled(names: tuple[str, ...], pictures: list[Image.Image]) -> Image.Image:
    """Return the pictures on one sheet, each under its name."""
    columns = min(COLUMNS, len(names))
    rows = -(-len(names) // columns)
    sheet = Image.new("RGB", (columns * WIDTH, rows * (HEIGHT + LABEL)), "white")
    writer = ImageDraw.Draw(sheet)
    for number, (name, picture) in enumerate(zip(names, pictures, strict=True)):
        left, top = number % columns * WIDTH, number // columns * (HEIGHT + LABEL)
        writer.text((left + 3, top + 1), name, fill="black")
        sheet.paste(picture, (left, top + LABEL))
    return sheet


def page() -> str:
    """Return the page as Markdown."""
    lines = [
        "# Renderers\n",
        "Every task at the same moment, drawn by each renderer in the [studio](looks.md#the-studio). Made by\n"
        "`python tools/renderer_sheets.py`. [Looks](looks.md) says what each renderer draws of a surface,\n"
        "[Light](lights.md) how far their pictures agree; the [gallery](gallery.md#path-traced) has `sapien-rt`.\n",
    ]
    for sheet, drawn in RENDERERS.items():
        lines += [f"## {drawn.title}\n", f"`--renderer {drawn.renderer}`. {drawn.text}\n"]
        lines += [f"![Every task, drawn by {drawn.title}](images/renderers/{sheet}.webp)\n"]
    return "\n".join(lines)


if __name__ == "__main__":
    main(tyro.cli(SheetSettings, description=__doc__))
