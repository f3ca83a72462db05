"""Process that expands one xacro file: reads an :class:`Order` and writes an :class:`Expansion`, or the error.

    python -P -m orbit_assets.xacro.process < order > result

The package xacro handles macros, conditions and blocks, with its ways to evaluate, open and look up replaced by ours.
The file's expressions are not Python (:mod:`orbit_assets.xacro.functions`). The limits here hold even if a
fault is found in their evaluator: the process may read the files that the model may name and Python's own, and can
write no file, start no other process, use no network and run no code that is made from text.
"""

from __future__ import annotations

import contextlib
import datetime
import importlib
import importlib.util
import os
import re
import resource
import subprocess
import sys
import sysconfig
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from xml.dom import expatbuilder
from xml.etree.ElementTree import Element

from orbit_assets.options import ReadOptions
from orbit_assets.outside import allowed_folders, allowed_path, package_folders
from orbit_assets.source_text import parse_xml, plain_document, read_text, read_xml
from orbit_assets.xacro.functions import evaluate, global_symbols, launch_symbols, tokenize
from orbit_assets.xacro.values import LARGEST, Expansion, ExpressionError, Function, Namespace, Order, check_value
from orbit_core.installing import install_extra
from orbit_core.interfaces.errors import AssetError

# Xacro files expanded to URDF by a process with limits, which can read the model's files only -------------------------

# Seconds for one file: macros may call themselves forever.
_SECONDS = 15
# Bytes of address space of the process, Python's own included.
_MEMORY = 2**30
# Most characters of the URDF.
_CHARACTERS = 16 * 2**20
# Most bytes that are read from the process: a character has up to four.
_BYTES = 4 * _CHARACTERS
# Substitutions of ROS in attributes, which files without a macro have too.
_SUBSTITUTION = re.compile(r"\$\((optenv|env|arg|eval)\s")


@dataclass(frozen=True)
class ExpandedXml:
    """Root element of a URDF file without macros, and notes on how they were expanded; without macros, no notes."""

    root: Element
    """Element ``<robot>``."""
    notes: tuple[str, ...] = ()
    """Sentences for the build report."""


def is_xacro(root: Element) -> bool:
    """Return True if a document holds xacro's macros, or substitutions in attributes that describe the robot."""
    if any(element.tag.startswith("xacro:") for element in root.iter()):
        return True
    # Only elements that describe the robot count: simulators' own elements use the same syntax for other purposes.
    described = (element for tag in ("link", "joint") for part in root.findall(tag) for element in part.iter())
    return any(_SUBSTITUTION.search(value) for element in described for value in element.attrib.values())


def read_expanded(path: Path, options: ReadOptions) -> ExpandedXml:
    """Read a URDF or xacro file, and expand its macros if it holds some.

    Raises:
        AssetError: it is no XML, or cannot be expanded.
    """
    root = read_xml(path, options)
    if is_xacro(root) or path.suffix.lower() == ".xacro":
        return expand_xacro(path, options)
    return ExpandedXml(root)


def expand_xacro(path: Path, options: ReadOptions) -> ExpandedXml:
    """Expand a xacro file to URDF, with the defaults of its arguments.

    A process with limits of memory, time and output does it (:mod:`orbit_assets.xacro.process`).

    Raises:
        AssetError: the package ``xacro`` is not installed, or the file cannot be expanded.
    """
    if importlib.util.find_spec("xacro") is None:
        raise AssetError(
            f"URDF file '{path}' holds xacro macros: {install_extra('xacro')}, or expand it with xacro first"
        )
    outside = options.allow_outside if isinstance(options.allow_outside, tuple) else ()
    order = Order(
        path=str(path.absolute()),
        packages={name: str(folder) for name, folder in options.packages.items()},
        outside=("/",) if options.allow_outside is True else tuple(map(str, outside)),
        environment={name: os.environ[name] for name in options.environment if name in os.environ},
        limits=options.limits,
        characters=_CHARACTERS,
        memory=_MEMORY,
        seconds=_SECONDS,
    )
    code, said = _answer(order)
    if code is None:
        raise AssetError(f"xacro file '{path}' takes over {_SECONDS} s to expand: a macro may call itself")
    if code != 0:
        raise AssetError(
            f"xacro file '{path}' cannot be expanded ({said or f'exit status {code}'}): correct it, or expand it "
            "with xacro yourself"
        )
    expansion = Expansion.decoded(said)
    notes = ["the file's xacro macros are expanded"]
    # A default may surprise a user who has set the variable.
    if held := sorted(set(os.environ) & set(expansion.unnamed)):
        notes.append(
            f"$(optenv ...) has its default for {', '.join(held)}, which are set: name them in "
            "ReadOptions(environment=...)"
        )
    return ExpandedXml(parse_xml(expansion.document, str(path), options.limits), tuple(notes))


def _answer(order: Order) -> tuple[int | None, str]:
    """Return the process's exit code, None if its time ran out, and its output."""
    process = subprocess.Popen(
        # -P keeps the working folder, which may be the model's, from where Python finds modules.
        [sys.executable, "-P", "-m", f"{__package__}.process"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        env=os.environ
        | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path)), "PYTHONUTF8": "1", "PYTHONHASHSEED": "0"},
    )
    # The event distinguishes a timeout from a crash by a signal.
    late = threading.Event()

    def stop() -> None:
        late.set()
        process.kill()

    timer = threading.Timer(_SECONDS, stop)
    timer.start()
    said = bytearray()
    try:
        with process:
            assert process.stdin is not None
            assert process.stdout is not None
            with contextlib.suppress(BrokenPipeError), process.stdin as orders:
                orders.write(order.encoded().encode())
            # Output is limited here too: the process could write without end.
            while len(said) <= _BYTES and (read := os.read(process.stdout.fileno(), 2**20)):
                said += read
            if len(said) > _BYTES:
                process.kill()
    except BaseException:
        process.kill()
        raise
    finally:
        timer.cancel()
    if late.is_set():
        return None, ""
    return process.returncode, said.decode("utf-8", "replace").strip() if len(said) <= _BYTES else "it writes too much"


# Most levels of lists and dictionaries in a YAML file, and of files that include one another.
_DEEPEST = 100


class Markup:
    """Expansion of one file.

    ``folders`` are those of packages that ``$(find NAME)`` has found: files there may be read as well.
    """

    def __init__(self, order: Order) -> None:
        self.order = order
        """File and permissions."""
        self.folders: list[str] = []
        self.unnamed: list[str] = []
        """Variables that took their default."""
        self.characters = 0
        """Characters of all files read so far, each inclusion counted."""
        # yaml and the decoders load here, before files of Python's library are all that may be executed.
        self.xacro, self.yaml = (importlib.import_module(name) for name in ("xacro", "yaml"))
        """Modules ``xacro`` and ``yaml``, which are imported on use."""
        self._replace()

    def expanded(self) -> Expansion:
        """Return the URDF.

        Raises:
            Exception: the file cannot be expanded.
        """
        self.xacro.init_stacks(self.order.path)
        document = self._parse(None, self.order.path)
        self.xacro.process_doc(document, verbosity=0)
        pieces = _Pieces(self.order.characters)
        document.writexml(pieces)
        return Expansion("".join(pieces.made), tuple(self.unnamed))

    def _replace(self) -> None:
        own: dict[str, Any] = {
            "safe_eval": lambda text, names, local=None: evaluate(text, names),
            "eval_extension": self._substitution,
            "parse": self._parse,
            "load_yaml": self._load_yaml,
            "_global_symbols": global_symbols(self._namespace()),
        }
        # Private functions of the package are replaced: another version may lack them, and would then evaluate Python.
        if missing := [name for name in own if name not in vars(self.xacro)]:
            raise ExpressionError(
                f'the package xacro is of a version without {", ".join(missing)}: pip install "xacro==2.1.*"'
            )
        vars(self.xacro).update(own)

    def _namespace(self) -> Namespace:
        """Return xacro's own functions."""
        silent = {name: lambda *words, **options: "" for name in ("message", "warning", "error", "print_location")}
        functions: dict[str, Callable[..., Any]] = silent | {
            "abs_filename": lambda name: self.xacro.abs_filename_spec(str(name)),
            "arg": self._argument,
            "dotify": lambda value: value,
            "fatal": _fatal,
            "load_yaml": self._load_yaml,
            "tokenize": tokenize,
        }
        return Namespace({name: Function(name, function) for name, function in functions.items()})

    def _arguments(self) -> Mapping[str, str]:
        return self.xacro.substitution_args_context["arg"]

    def _argument(self, name: Any) -> str:
        if name not in self._arguments():
            raise ExpressionError(f"argument '{name}' is not defined: give it a default by <xacro:arg>")
        return self._arguments()[name]

    def _substitution(self, text: str) -> str:
        """Return the value of ``$(...)``."""
        command, rest = (*text[2:-1].split(None, 1), "", "")[:2]
        words = rest.split()
        if command == "eval":
            values = {name: _converted(value) for name, value in self._arguments().items()}
            functions = {
                "arg": lambda name: _converted(self._argument(name)),
                "env": self._variable,
                "optenv": self._optional_variable,
                "find": self._found,
            }
            made = {name: Function(name, function) for name, function in functions.items()}
            return str(evaluate(rest, {**values, **launch_symbols(), **made}))
        if command == "cwd" and not words:
            return os.getcwd()
        if command == "optenv" and words:
            return self._optional_variable(words[0], " ".join(words[1:]))
        commands = {"arg": self._argument, "env": self._variable, "find": self._found}
        if command not in commands or len(words) != 1:
            raise ExpressionError(f"'{text}' is no substitution: give arg, cwd, env, eval, find or optenv")
        return commands[command](words[0])

    def _variable(self, name: Any) -> str:
        if name not in self.order.environment:
            raise ExpressionError(
                f"the environment variable '{name}' is not set, or not among ReadOptions(environment=...): name it "
                "there, and set it"
            )
        return self.order.environment[name]

    def _optional_variable(self, name: Any, default: Any = "") -> str:
        if name not in self.order.environment:
            self.unnamed.append(str(name))
            return default
        return self.order.environment[name]

    def _found(self, package: Any) -> str:
        """Return a package's folder, as for ``package://``; from then on its files may be read."""
        folder = next(package_folders(str(package), Path(self.order.path), self._options()), None)
        if folder is None:
            raise FileNotFoundError(f"package '{package}' is unknown, give its folder by ReadOptions(packages=...)")
        self.folders.append(str(folder.resolve()))
        return str(folder)

    def _options(self) -> ReadOptions:
        options = self.order.options()
        if options.allow_outside is True:
            return options
        return replace(options, allow_outside=(*map(Path, self.order.outside), *map(Path, self.folders)))

    def _text(self, name: str) -> str:
        """Return the text of a file that the model may name."""
        path = allowed_path(name, self.order.path, self._options())
        if not path.exists():
            raise self.xacro.XacroException(exc=FileNotFoundError(f"no such file: {name}"))  # some are optional
        return read_text(path, self._options())

    def _parse(self, source: Any, filename: str) -> Any:
        """Parse a file to a DOM document, under the limits of all XML files."""
        if len(self.xacro.filestack) > _DEEPEST:
            raise ExpressionError(f"{_DEEPEST} files include one another: an include may lead back to its own file")
        text = self._text(filename)
        self._count(len(text))
        # Parsed twice: the first parser enforces the limits and rejects entities, the second builds the DOM.
        parse_xml(text, filename, self.order.limits)
        return expatbuilder.parseString(plain_document(text), namespaces=False)

    def _load_yaml(self, filename: Any) -> Any:
        """Return the contents of a YAML file; ``!degrees`` and the like convert to radians and metres."""
        text = self._text(self.xacro.abs_filename_spec(str(filename)))
        self._count(len(text))

        class Loader(self.yaml.SafeLoader):
            pass

        for unit in self.xacro.ConstructUnits:
            Loader.add_constructor(unit.value.tag, unit.constructor)
        return check_value(_Plain().value(self.yaml.load(text, Loader), _DEEPEST))

    def _count(self, characters: int) -> None:
        """Include a file's length in the total; a file may include another many times."""
        self.characters += characters
        if self.characters > self.order.limits.file_bytes:
            raise ExpressionError(
                f"it includes more than {self.order.limits.file_bytes} characters: raise ReadLimits.file_bytes"
            )


class _Pieces:
    """Text written piece by piece, up to a limit."""

    def __init__(self, most: int) -> None:
        self.most = most
        self.made: list[str] = []

    def write(self, text: str) -> None:
        self.most -= len(text)
        if self.most < 0:
            raise ExpressionError("it expands to more text than one model may have")
        self.made.append(text)


def _fatal(*words: Any) -> None:
    raise ExpressionError(" ".join(map(str, words)))


def _converted(text: str) -> Any:
    """Return an argument's value as roslaunch converts it: a number, a truth value or text."""
    try:
        return float(text) if "." in text else int(text)
    except ValueError:
        return {"true": True, "false": False}.get(text.lower(), text)


class _Plain:
    """Copier of YAML's values to those of expressions: a date is its text, and an alias is written out."""

    def __init__(self) -> None:
        self.count = 0

    def value(self, value: Any, depth: int) -> Any:
        """Return the copy of a value, of at most so many lists and dictionaries within each other."""
        self.count += 1
        if depth == 0:
            raise ExpressionError(f"a YAML file nests its lists deeper than {_DEEPEST}, or in themselves")
        if self.count > LARGEST:
            raise ExpressionError(f"a YAML file has more than {LARGEST} values, its aliases written out")
        if isinstance(value, dict):
            return {self.value(key, depth - 1): self.value(each, depth - 1) for key, each in value.items()}
        if isinstance(value, list):
            return [self.value(each, depth - 1) for each in value]
        return str(value) if isinstance(value, datetime.date) else value


_WRITING = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND
# Operations that no xacro file needs, by prefixes of the interpreter's audit events.
_REFUSED = (
    "subprocess.", "os.", "socket.", "shutil.", "ctypes.", "pty.", "gc.", "code.", "mmap.", "fcntl.", "sys._",
    "resource.", "signal.", "tempfile.", "_thread.", "syslog.", "webbrowser.", "urllib.", "http.", "ftplib.",
)  # fmt: skip
_PATHS = [sysconfig.get_path(name) for name in ("stdlib", "purelib", "platlib")]
# Folders of Python's own files, from which modules may still load.
_LIBRARY = [*_PATHS, *map(os.path.realpath, _PATHS)]
# Events of includes by pattern; the files found are opened, or not, as any file.
_LISTING = ("os.listdir", "os.scandir")


def main() -> int:
    """Expand the file that the order on standard input names; return the process's exit code."""
    order = Order.decoded(sys.stdin.read())
    for name in set(os.environ) - {"HOME"}:  # the user's home, above which no packages are looked for
        del os.environ[name]
    markup = Markup(order)
    # Before the file is read: from here on the process cannot do anything else.
    restrict(order, markup.folders)
    try:
        said = markup.expanded().encoded()
    except Exception as error:  # a file's faults are of any class
        if _for_memory(error):
            _write(f"it takes more than {order.memory // 2**20} MiB of memory")
        else:
            _write(f"{type(error).__name__}: {' '.join(str(error).split())}"[:2000])
        return 1
    _write(said)
    return 0


def _write(text: str) -> None:
    """Write to standard output, halves of surrogate pairs included, which text of a file may hold."""
    sys.stdout.buffer.write(text.encode("utf-8", "backslashreplace"))


def _for_memory(error: BaseException | None) -> bool:
    """Return True if an error is a lack of memory, or was raised for one."""
    return error is not None and (isinstance(error, MemoryError) or _for_memory(error.__context__))


def restrict(order: Order, folders: list[str]) -> None:
    """Restrict this process to the operations that expansion needs, irreversibly.

    Args:
        order: limits of memory and processor time, and the folders that may be read.
        folders: further folders that may be read; the list may grow later.
    """
    for limit, most in (
        (resource.RLIMIT_AS, order.memory),
        (resource.RLIMIT_CPU, order.seconds + 1),  # the caller counts wall time, which is up first
        (resource.RLIMIT_FSIZE, 0),  # what is written to a pipe is no file
        (resource.RLIMIT_CORE, 0),
    ):
        resource.setrlimit(limit, (most, most))
    given = [os.path.realpath(folder) for folder in (*allowed_folders(order.path, order.options()), *order.outside)]
    sys.addaudithook(_guard(given, folders))


# Audit hooks see every open, import and exec of the interpreter, and cannot be removed.
def _guard(given: list[str], later: list[str]) -> Callable[[str, tuple[Any, ...]], None]:
    def check(event: str, arguments: tuple[Any, ...]) -> None:
        if event == "open":
            path, mode, flags = arguments
            if isinstance(path, int):
                return
            writes = any(letter in (mode or "") for letter in "wax+") or bool(flags & _WRITING)
            check_place(path, writes=writes)
        elif event in _LISTING:
            check_place(arguments[0])
        elif event == "exec":
            name = arguments[0].co_filename
            if not name.startswith(("<frozen ", *_LIBRARY)):
                raise RuntimeError(f"it runs code of '{name}', which no model may")
        elif event.startswith(_REFUSED):
            raise RuntimeError(f"it calls {event}, which no model may")

    def check_place(path: Any, *, writes: bool = False) -> None:
        place = os.path.realpath(os.fsdecode(path))
        if writes or not any(_below(place, folder) for folder in (*given, *later, *_LIBRARY)):
            raise RuntimeError(f"it opens '{place}', which the model may not: ReadOptions(allow_outside=...)")

    return check


def _below(place: str, folder: str) -> bool:
    return place == folder or place.startswith(os.path.join(folder, ""))


if __name__ == "__main__":
    sys.exit(main())
