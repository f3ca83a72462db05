"""Measure the prose of docstrings, comments and pages: `python tools/prose.py [--list] [PATH...]`.

Prints for each path the share of docstrings that open with a question word or a fragment, dialect words in a thousand,
and the share of lines that are comments. Of pages in Markdown it counts dialect words outside of code. `--list` names
each docstring to rewrite. `--most-openings`, `--most-words` and `--least-comments` turn a figure beyond them into a
failure.
"""

from __future__ import annotations

import argparse
import ast
import io
import re
import sys
import tokenize
from dataclasses import dataclass, field
from pathlib import Path

# First words of a docstring that hide its verb or noun, and words that have a plainer one in the field.
OPENINGS = re.compile(
    r"(What|Whether|Who|Whom|Whose|Which|Of|As|Those|That|Where|When|How|Why|For|From|By|Than|Nothing|If|In|On|At|To|Out|With|Is|"
    r"Has|Had|Such|It|Its|They|Them)\b"
)
DIALECT = re.compile(
    r"\b(anew|besides?|tells?|told|reckon\w*|mend(?:s|ed|ing)?|lies|stands? for|comes? to(?! rest)|came to(?! rest)|"
    r"of its own|to be had|at the most|hence|whoever|whatever|wherever|nothing else|spelt|makes? of|go about|"
    r"what it came)\b",
    re.IGNORECASE,
)
# Code of a page: fenced blocks, and names between backticks.
_CODE = re.compile(r"^```.*?^```|`[^`\n]+`", re.DOTALL | re.MULTILINE)


@dataclass
class Prose:
    """Figures of the docstrings, comments and pages below one path."""

    docstrings: int = 0
    words: int = 0
    lines: int = 0
    comments: int = 0
    openings: list[str] = field(default_factory=list)
    dialect: list[str] = field(default_factory=list)

    def read(self, path: Path) -> None:
        """Add one source file or page."""
        text = path.read_text(encoding="utf-8")
        if path.suffix == ".md":
            # Code is blanked and not cut, so that line numbers stay right.
            plain = _CODE.sub(lambda code: re.sub(r"\S", " ", code[0]), text)
            for number, line in enumerate(plain.splitlines(), 1):
                self._count(line, f"{path}:{number}")
            return
        self.lines += text.count("\n")
        for node in ast.walk(ast.parse(text)):
            if not isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
                continue
            if not (docstring := ast.get_docstring(node)):
                continue
            self.docstrings += 1
            place = f"{path}:{node.body[0].lineno}"
            if OPENINGS.match(docstring):
                self.openings.append(f"{place}: {docstring.splitlines()[0]}")
            self._count(docstring, place)
        for token in tokenize.generate_tokens(io.StringIO(text).readline):
            if token.type == tokenize.COMMENT and not re.match(r"#\s*(type:|noqa|pyright|ruff|!)", token.string):
                self.comments += 1
                self._count(token.string, f"{path}:{token.start[0]}")

    def _count(self, text: str, place: str) -> None:
        self.words += len(text.split())
        self.dialect += [f"{place}: {match.group()}" for match in DIALECT.finditer(text)]

    @property
    def openings_share(self) -> float:
        """Docstrings that open with a fragment, in per cent."""
        return 100 * len(self.openings) / max(self.docstrings, 1)

    @property
    def dialect_rate(self) -> float:
        """Dialect words in a thousand."""
        return 1000 * len(self.dialect) / max(self.words, 1)

    @property
    def comments_share(self) -> float:
        """Comments in per cent of lines."""
        return 100 * self.comments / max(self.lines, 1)


def measure(path: Path) -> Prose:
    """Read one file, or every Python file and page below a folder, hidden folders left out."""
    prose = Prose()
    files = [path] if path.is_file() else sorted(file for file in path.rglob("*") if file.suffix in (".py", ".md"))
    for file in files:
        if not any(part.startswith(".") or part == "build" for part in file.relative_to(path.parent).parts):
            prose.read(file)
    return prose


def main() -> int:
    """Print the figures; return 1 where one is beyond its limit."""
    parser = argparse.ArgumentParser(description="Measure the prose of docstrings, comments and pages.")
    parser.add_argument("paths", nargs="*", type=Path, default=[Path("orbit_core"), Path("orbit_tasks")])
    parser.add_argument("--list", action="store_true", help="name each docstring and word to rewrite")
    parser.add_argument("--most-openings", type=float, default=100.0, help="per cent of docstrings")
    parser.add_argument("--most-words", type=float, default=1000.0, help="in a thousand words")
    parser.add_argument("--least-comments", type=float, default=0.0, help="per cent of lines")
    options = parser.parse_args()
    failed = False
    for path in options.paths:
        prose = measure(path)
        print(
            f"{path}: {len(prose.openings)} of {prose.docstrings} docstrings ({prose.openings_share:.1f} %) open with "
            f"a fragment, {prose.dialect_rate:.1f} dialect words in a thousand, "
            f"comments {prose.comments_share:.1f} % of lines"
        )
        if options.list:
            print("\n".join(prose.openings + prose.dialect))
        failed |= prose.openings_share > options.most_openings or prose.dialect_rate > options.most_words
        failed |= prose.comments_share < options.least_comments
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
