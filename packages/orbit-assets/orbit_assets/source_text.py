"""XML files: text in any encoding, element trees under the limits of the caller, and fields of their elements.

:class:`Findings` collects faults, omissions and remarks of one reading; errors name file, element and remedy.
"""

from __future__ import annotations

import codecs
import functools
import inspect
import os
import re
import typing
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Concatenate, ParamSpec, TypeVar
from xml.etree.ElementTree import Element, TreeBuilder
from xml.parsers import expat

from orbit_assets.options import ReadLimits, ReadOptions, Unsupported
from orbit_assets.outside import check_file
from orbit_core.configuration import TypeChecker
from orbit_core.interfaces.errors import ArgumentError, AssetError, OrbitError
from orbit_core.scene.pose import Vector3

# Errors of parsers and of arithmetic as :class:`AssetError`, with the file and the element that caused them.
# An argument of the caller is checked before, for it is no fault of the file.

# Most characters of a message; parsers quote whole files.
_LONGEST = 1000

_CHECKER = TypeChecker()

_P = ParamSpec("_P")
_R = TypeVar("_R")


@contextmanager
def naming(place: str) -> Iterator[None]:
    """Turn errors raised within into one :class:`AssetError` of one line that names ``place``.

    An :class:`AssetError` that names the place already passes as it is. Nested uses name the outer place first.

    Raises:
        AssetError: any exception was raised within, except for those that end the process.
    """
    try:
        yield
    except OrbitError as error:
        text = str(error)
        if isinstance(error, AssetError) and place in text and "\n" not in text:
            raise
        said = one_line(text)
        raise AssetError(said if place in said else f"{place}: {said}") from error
    # Parsers and arithmetic raise errors of any class; each is a fault of the file.
    except Exception as error:
        cause = one_line(f"{type(error).__name__}: {error}" if str(error) else type(error).__name__)
        raise AssetError(f"{place} cannot be read ({cause}): correct the file or export it again") from error


def names_file(read: Callable[Concatenate[Path | str, _P], _R]) -> Callable[Concatenate[Path | str, _P], _R]:
    """Make a reader name the file, its first argument, in all errors (:func:`naming`), but for those of arguments.

    The reader raises ArgumentError where an argument is not of the type that it is annotated with.
    """
    signature = inspect.signature(read)

    @functools.wraps(read)
    def named(path: Path | str, *args: _P.args, **kwargs: _P.kwargs) -> _R:
        if not isinstance(path, str | os.PathLike):
            raise ArgumentError(f"path is {path!r}: give the path of a file")
        given = signature.bind(path, *args, **kwargs).arguments
        # Arguments are checked outside of ``naming``: a wrong one is no fault of the file.
        for name, value in given.items():
            _CHECKER.check_value(value, _hints(read)[name], name)
        with naming(str(path)):
            return read(path, *args, **kwargs)

    return named


# Annotations are strings and may name types that are imported later: they are resolved at the first call.
@functools.cache
def _hints(read: Callable[..., object]) -> dict[str, typing.Any]:
    return typing.get_type_hints(read)


def one_line(text: str) -> str:
    """Join a message to one line, cut where it quotes too much."""
    joined = " ".join(text.split())
    return joined if len(joined) <= _LONGEST else f"{joined[:_LONGEST]} ..."


# Places that a note lists by name; it counts the rest.
_MOST = 3


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
        """Return the error for a fault of the file, to be raised."""
        return AssetError(f"in {self.place}, {fault}: {remedy}")

    def note(self, text: str) -> None:
        """Record a remark once, however often it occurs."""
        self._notes[text] = None

    def leave_out(self, what: str, where: str) -> None:
        """Record an omission that changes no motion of the model, or that ORBIT keeps elsewhere."""
        self._left_out.setdefault(what, []).append(where)

    def unsupported(self, what: str, where: str, remedy: str) -> None:
        """Reject something that the description cannot hold, or record it as left out if the options say so.

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
        """All remarks and omissions, in the order of their first occurrence."""
        left_out = (f"{what} is left out of {_listed(where)}" for what, where in self._left_out.items())
        return (*self._notes, *left_out)


def _listed(places: list[str]) -> str:
    distinct = list(dict.fromkeys(places))
    if len(distinct) <= _MOST:
        return ", ".join(distinct)
    return f"{', '.join(distinct[:_MOST])} and {len(distinct) - _MOST} more"


# First bytes of files by encoding; UTF-32 before UTF-16, whose little-endian mark is its beginning.
_MARKS = (
    (codecs.BOM_UTF8, "utf-8"),
    (codecs.BOM_UTF32_LE, "utf-32-le"),
    (codecs.BOM_UTF32_BE, "utf-32-be"),
    (codecs.BOM_UTF16_LE, "utf-16-le"),
    (codecs.BOM_UTF16_BE, "utf-16-be"),
    (b"<\0", "utf-16-le"),
    (b"\0<", "utf-16-be"),
)
_DECLARATION = re.compile(r"\s*<\?xml\b[^>]*\?>")
_COMMENT = re.compile(r"<!--.*?-->", re.DOTALL)
_ENCODING = re.compile(rb"<\?xml[^>]*\bencoding\s*=\s*[\"']([\w.:-]+)[\"']")


def read_xml(path: Path | str, options: ReadOptions) -> Element:
    """Return the root element of an XML file, without comments and instructions; prefixes stay in names, ``xacro:if``.

    Prefixes need no declaration, for published files use ``xacro:`` and ``gazebo:`` without one.

    Raises:
        AssetError: the file is missing, too large, not well formed, declares entities, or goes beyond the limits.
    """
    return parse_xml(read_text(path, options), str(path), options.limits)


def read_text(path: Path | str, options: ReadOptions) -> str:
    """Read the text of an XML file: by its byte-order mark, else as it declares, else UTF-8, else Latin-1.

    Raises:
        AssetError: the file is missing or too large, or its bytes are not of the encoding that it declares.
    """
    check_file(path, options)
    data = Path(path).read_bytes()
    for mark, encoding in _MARKS:
        if data.startswith(mark):
            return _decoded(data, encoding, path).removeprefix("\ufeff")
    # An XML declaration is within the first 200 bytes of any file that has one.
    declared = _ENCODING.search(data[:200])
    if declared is not None:
        name = declared.group(1).decode("ascii")
        # Without a mark, bytes in which the declaration could be read are no UTF-16, although it says so.
        return _decoded(data, "utf-8" if name.lower().startswith(("utf-16", "utf-32", "ucs")) else name, path)
    try:
        return data.decode("utf-8")
    # Old exporters write Latin-1 without saying so; every byte sequence is valid in it.
    except UnicodeDecodeError:
        return data.decode("latin-1")


def parse_xml(text: str, name: str, limits: ReadLimits) -> Element:
    """Parse XML text to its root element, as :func:`read_xml` does.

    Args:
        text: the document; an encoding that it declares no longer matters.
        name: of the document, for messages.
        limits: of elements and of nesting.

    Raises:
        AssetError: as :func:`read_xml`.
    """
    builder = _Builder(name, limits)
    # One call per run of text instead of one per line.
    parser = expat.ParserCreate("utf-8")
    parser.buffer_text = True
    parser.StartElementHandler = builder.start
    parser.EndElementHandler = builder.end
    parser.CharacterDataHandler = builder.tree.data
    parser.EntityDeclHandler = builder.refuse_entity
    try:
        parser.Parse(plain_document(text), True)
    except expat.ExpatError as error:
        raise AssetError(f"{name} is not well-formed XML ({error}): correct it") from None
    return builder.tree.close()


def plain_document(text: str) -> bytes:
    """Return XML text as UTF-8 without its declaration and comments, which parsers would stop at."""
    document = _DECLARATION.sub("", text, count=1) if _DECLARATION.match(text) else text
    # Published files draw lines of hyphens in comments, which the standard forbids; line numbers stay as they are.
    document = _COMMENT.sub(lambda comment: "\n" * comment.group().count("\n"), document)
    return document.lstrip().encode("utf-8", "replace")


class _Builder:
    """Tree builder that stops the parser at rejected content."""

    def __init__(self, name: str, limits: ReadLimits) -> None:
        self.name = name
        self.limits = limits
        self.tree = TreeBuilder()
        self.elements = 0
        self.depth = 0

    def start(self, tag: str, attributes: dict[str, str]) -> None:
        self.elements += 1
        self.depth += 1
        if self.elements > self.limits.elements:
            raise AssetError(
                f"{self.name} has more than {self.limits.elements} elements: split it, or raise ReadLimits.elements"
            )
        if self.depth > self.limits.nesting:
            raise AssetError(
                f"{self.name} nests <{tag}> in {self.limits.nesting} others: flatten it, or raise ReadLimits.nesting"
            )
        self.tree.start(tag, attributes)

    def end(self, tag: str) -> None:
        self.depth -= 1
        self.tree.end(tag)

    def refuse_entity(self, entity: str, *_: object) -> None:
        """Reject every entity: it may expand to gigabytes, or include another file."""
        raise AssetError(f"{self.name} declares the entity '{entity}': write its text out")


def _decoded(data: bytes, encoding: str, path: Path | str) -> str:
    try:
        return data.decode(encoding)
    except (UnicodeDecodeError, LookupError) as error:
        raise AssetError(f"{path} is not in its encoding, {encoding} ({error}): save it as UTF-8") from None


class Fields:
    """Reader of attributes and child elements; errors name file, element and remedy.

    ``where`` in all methods is the thing being read, as "joint 'elbow'".
    """

    def __init__(self, findings: Findings) -> None:
        self.findings = findings
        """Errors and notes so far."""

    def attribute(self, element: Element, key: str, where: str) -> str:
        """Return the attribute's text.

        Raises:
            AssetError: it is missing.
        """
        value = element.get(key)
        if value is None:
            raise self.findings.error(f"{where} lacks attribute '{key}' of <{element.tag}>", "add it")
        return value

    def child(self, element: Element, tag: str, where: str) -> Element:
        """Return the first child element with the tag.

        Raises:
            AssetError: it is missing.
        """
        child = element.find(tag)
        if child is None:
            raise self.findings.error(f"{where} lacks <{tag}> in <{element.tag}>", "add it")
        return child

    def number(self, element: Element, key: str, where: str, default: float | None = None) -> float:
        """Return the number in an attribute; ``default`` where it is missing.

        Raises:
            AssetError: it is missing without a default, or no number.
        """
        if default is not None and element.get(key) is None:
            return default
        return self.numbers(element, key, where, 1)[0]

    def vector(self, element: Element, key: str, where: str, default: Vector3 | None = None) -> Vector3:
        """Return the three numbers in an attribute; ``default`` where it is missing.

        Raises:
            AssetError: it is missing without a default, or not three numbers.
        """
        if default is not None and element.get(key) is None:
            return default
        x, y, z = self.numbers(element, key, where, 3)
        return (x, y, z)

    def numbers(self, element: Element, key: str, where: str, count: int) -> list[float]:
        """Return ``count`` numbers separated by spaces from an attribute.

        Raises:
            AssetError: it is missing, or holds another count or no numbers.
        """
        text = self.attribute(element, key, where)
        try:
            values = [float(word) for word in text.split()]
        except ValueError:
            values = []
        if len(values) != count:
            raise self.findings.error(f'{where} has {key}="{text}" in <{element.tag}>', f"give {count} number(s)")
        return values
