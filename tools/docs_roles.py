"""Extension of mkdocstrings' parser: Sphinx roles and literal blocks in docstrings become Markdown, terms get docs.

``:class:`Pose` `` becomes a link to the page of `Pose`, and plain code where the name has no page.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import Any

import griffe  # pyright: ignore[reportMissingImports]

sys.path.insert(0, str(Path(__file__).parent))
import docs_api

_ROLE = re.compile(r":(?:mod|class|func|meth|attr|data|obj|exc):`~?([^`]+)`")
_LITERAL = re.compile(r"::(?=\n\n)")


class Roles(griffe.Extension):
    """Rewrites each docstring as it is collected."""

    def on_object(self, *, obj: griffe.Object, **kwargs: Any) -> None:
        """Replace roles by links, which are looked up in the object, its class and its module.

        A term of a task without a docstring gets that of its function.
        """
        if obj.docstring is None and isinstance(obj, griffe.Attribute):
            text = docs_api.term_docstring(str(obj.annotation), str(obj.value), obj.module.path)
            obj.docstring = griffe.Docstring(text, parent=obj) if text else None
        if obj.docstring is None:
            return
        scopes = dict.fromkeys((obj.path, obj.path.rpartition(".")[0], obj.module.path))
        text = _ROLE.sub(lambda role: _link(role[1], tuple(scopes)), obj.docstring.value)
        obj.docstring.value = _LITERAL.sub(":", text)


def _link(name: str, scopes: tuple[str, ...]) -> str:
    for full in (*(f"{scope}.{name}" for scope in scopes), name):
        if place := docs_api.resolve(full):
            return f"[`{name}`][{place[1] or place[0]}]"
    return f"`{name}`"
