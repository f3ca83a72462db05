"""Output of the commands: consoles, tables, progress bars and JSON files."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from rich import box
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table
from rich.text import Text

from orbit_core.files import written_whole

# Characters of a line where the output is no terminal, so that pipes and files get whole names
_WIDTH = 140


def console() -> Console:
    """Return the console that results are printed on."""
    plain = _PlainConsole()
    # A narrow default width would cut names in pipes and files.
    return plain if plain.is_terminal else _PlainConsole(width=_WIDTH)


class _PlainConsole(Console):
    """A console that prints names and texts of files as they are: neither as markup nor as commands to the terminal."""

    def __init__(self, width: int | None = None) -> None:
        super().__init__(width=width, markup=False, emoji=False)

    def render_str(self, text: str, *args: Any, **kwargs: Any) -> Text:
        return super().render_str(printable(text), *args, **kwargs)


def printable(text: str) -> str:
    """Return a text with a replacement character for each that would be a command to the terminal."""
    return "".join(each if each.isprintable() or each in "\n\t" else "\N{REPLACEMENT CHARACTER}" for each in text)


def new_table(*headings: str, title: str | None = None) -> Table:
    """Return a table with a rule under its headings; the first column, which holds names, is never cut."""
    table = Table(title=title, title_justify="left", box=box.SIMPLE_HEAD)
    for index, heading in enumerate(headings):
        table.add_column(heading, no_wrap=index == 0, overflow="fold")
    return table


def progress_bar() -> Progress:
    """Return a progress bar on stderr, gone when it is done; it shows nothing where stderr is no terminal."""
    # On stderr, so that results on stdout can be piped.
    console = Console(stderr=True)
    columns = (TextColumn("{task.description}", markup=False), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    return Progress(*columns, console=console, transient=True, disable=not console.is_terminal)


def write_json(path: Path | None, values: Any) -> None:
    """Write the values to a file, if there is one to write; the file is whole or not there."""
    if path is None:
        return
    with written_whole(path) as written:
        written.write_text(json.dumps(values, indent=2) + "\n", encoding="utf-8")


def print_heading(console: Console, title: str, text: str) -> None:
    """Print a title in bold, and a text after it."""
    console.print(Text.assemble((title, "bold"), f": {text}"))


def print_line(console: Console, label: str, value: str) -> None:
    """Print a label in bold, and a value after it."""
    console.print(Text.assemble((label, "bold"), f": {value}"))


def print_rows(console: Console, left: str, right: str, rows: Iterable[tuple[str, Any]]) -> None:
    """Print a table of two columns."""
    table = new_table(left, right)
    for key, value in rows:
        table.add_row(key, Text(str(value)))
    console.print(table)
