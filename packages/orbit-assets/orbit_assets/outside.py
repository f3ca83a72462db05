"""Files that a model may open: those in its folder, of its packages, and of folders that the caller allows.

Archives and pictures are measured before they are unpacked.
"""

from __future__ import annotations

import stat
import struct
import zipfile
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import unquote, urlsplit

from orbit_assets.options import ReadOptions
from orbit_core.interfaces.errors import AssetError

_INSTALLED = ("site-packages", "dist-packages")
# Folders in which distributions made by cmeel keep files that are not Python.
_SHARE = ("cmeel.prefix", "share")
# Levels above a model at which its package's folder may be, where no file marks it.
_NEAR = 3
_PACKAGE_SCHEMES = ("package://", "model://")


def resolve_file(
    reference: str | Path, base: Path | str, options: ReadOptions, *, model: Path | str | None = None
) -> Path:
    """Return the file that a model names, if it may be opened.

    Args:
        reference: as for :func:`allowed_path`.
        base: the file that holds the reference, or the folder that relative references start from.
        options: packages, further folders that are allowed, and the largest size.
        model: the model's main file, where ``base`` is another one.

    Raises:
        AssetError: the file is elsewhere, is missing, no regular file or too large, or its package is unknown.
    """
    path = allowed_path(reference, base, options, model=model)
    check_file(path, options)
    return path


def allowed_path(
    reference: str | Path, base: Path | str, options: ReadOptions, *, model: Path | str | None = None
) -> Path:
    """Return the path of a file that a model names, if it may be opened, whether or not it exists.

    It may be opened if it is, with links followed, in one of the :func:`allowed_folders` or in the package that the
    reference names.

    Args:
        reference: a path, or a URI ``file://``, ``package://NAME/...`` or ``model://NAME/...``.
        base: the file that holds the reference, or the folder that relative references start from.
        options: packages, and further folders that are allowed.
        model: the model's main file, where ``base`` is another one.

    Raises:
        AssetError: the file is elsewhere, or its package is unknown.
    """
    base = Path(base)
    main = Path(model) if model is not None else base
    path, package = _located(str(reference), base, main, options)
    # Links are followed before the comparison: one inside the folder may point anywhere.
    try:
        real = path.resolve()
        folders = [folder.resolve() for folder in (*allowed_folders(main, options), *package)]
    except (OSError, ValueError, RuntimeError) as error:
        raise AssetError(f"'{reference}' is no path ({error}): correct it") from None
    if options.allow_outside is not True and not any(real.is_relative_to(folder) for folder in folders):
        raise AssetError(
            f"'{reference}' leads to {real}, outside the model's folder {folders[0]} and the packages named: name its "
            "package, or allow its folder by ReadOptions(allow_outside=(folder,))"
        )
    return path


def check_file(path: Path | str, options: ReadOptions) -> None:
    """Check that a file that is about to be read exists, is regular, and has a size that the limits allow.

    Raises:
        AssetError: it is not.
    """
    try:
        status = Path(path).stat()
    except (OSError, ValueError):
        raise AssetError(f"file '{path}' does not exist: put it there or correct its path") from None
    # A pipe or a device would block or never end.
    if not stat.S_ISREG(status.st_mode):
        raise AssetError(f"'{path}' is no regular file: name a file that holds data")
    if status.st_size > options.limits.file_bytes:
        raise AssetError(
            f"file '{path}' has {status.st_size} bytes: make it smaller, or raise ReadLimits.file_bytes from "
            f"{options.limits.file_bytes}"
        )


def allowed_folders(model: Path | str, options: ReadOptions) -> tuple[Path, ...]:
    """Return the folders below which a model may name files: its own first, the packages', and those of the caller."""
    outside = options.allow_outside if isinstance(options.allow_outside, tuple) else ()
    return (model_folder(model), *map(Path, options.packages.values()), *map(Path, outside))


def model_folder(model: Path | str) -> Path:
    """Return the folder that a model's files share.

    It is the root of the installed distribution that holds the model, or else of the ROS package (the nearest folder
    above with a ``package.xml``), or else the folder of the model's file.
    """
    path = Path(model).absolute()
    own = path if path.is_dir() else path.parent
    return _installed_root(own) or next((f for f in (own, *own.parents) if (f / "package.xml").is_file()), own)


def _located(reference: str, base: Path, model: Path, options: ReadOptions) -> tuple[Path, tuple[Path, ...]]:
    """Return the path of a reference, and the folder of the package that it names, if it names one."""
    for scheme in _PACKAGE_SCHEMES:
        if reference.startswith(scheme):
            # Some tools write an empty package before the package's name, or for the model's own folder.
            package, _, inner = reference.removeprefix(scheme).removeprefix("/").partition("/")
            if reference.startswith(f"{scheme}/") and not list(package_folders(package, model, options)):
                package, inner = "", f"{package}/{inner}" if inner else package
            folder, path = _in_package(reference, package, unquote(inner).lstrip("/"), model, options)
            return path, (folder,)
    if reference.startswith("file:"):
        reference = _local_path(reference)
    if "://" in reference:
        raise AssetError(f"'{reference}' is no file on this machine: fetch it and name its path")
    return (base if base.is_dir() else base.parent) / reference, ()


def _local_path(uri: str) -> str:
    """Return the path of a ``file:`` URI; relative to the file that names it where the URI gives no absolute one.

    Exporters write ``file://meshes/part.stl``, whose first folder is, by the standard, a machine.
    """
    parts = urlsplit(uri)
    host = "" if parts.netloc == "localhost" else parts.netloc
    return unquote(f"{host}{parts.path}")


def _in_package(reference: str, package: str, inner: str, model: Path, options: ReadOptions) -> tuple[Path, Path]:
    """Return the first folder that may be the package and has the file, or else the first; and the file in it."""
    folders = list(package_folders(package, model, options))
    if not folders:
        raise AssetError(
            f"'{reference}' is in an unknown package: give its folder, ReadOptions(packages={{'{package}': folder}})"
        )
    folder = next((each for each in folders if (each / inner).is_file()), folders[0])
    return folder, folder / inner


def package_folders(package: str, model: Path, options: ReadOptions) -> Iterator[Path]:
    """Yield the folders that may be a package: the one that the caller gives, or those of its name around the model.

    These are the folders above the model, below the user's home, and one next to the model's file.
    """
    if not package:
        yield from allowed_folders(model, options)
    elif package in options.packages:
        yield Path(options.packages[package])
    else:
        shared = model_folder(model).resolve()
        home = Path.home()
        above = [folder for folder in (model.resolve(), *model.resolve().parents) if folder.is_dir()]
        for level, folder in enumerate(above):
            near = level < _NEAR or folder.is_relative_to(shared)
            # A folder above the home could be anybody's: /home/user/robot must not make /home a package.
            if folder.name == package and near and not home.is_relative_to(folder):
                yield folder
        own = model.parent.resolve()
        beside = (own / package).resolve()
        if beside.is_dir() and beside.parent == own:  # to some tools a package is a folder like others
            yield beside


def _installed_root(folder: Path) -> Path | None:
    """Return the top folder of the installed distribution around a folder, judged by the path alone."""
    parts = folder.parts
    for index, part in enumerate(parts):
        if part in _INSTALLED:
            depth = index + (4 if parts[index + 1 : index + 3] == _SHARE else 2)
            return Path(*parts[:depth]) if len(parts) >= depth else None
    return None


_PNG = b"\x89PNG\r\n\x1a\n"


def check_archive(path: Path, options: ReadOptions) -> None:
    """Check that a zip archive (USDZ, ZAE, 3MF) unpacks to no more than the limits allow.

    Raises:
        AssetError: it would, or it is no zip archive.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            size = sum(entry.file_size for entry in archive.infolist())
    except (zipfile.BadZipFile, OSError, ValueError) as error:
        raise AssetError(f"{path} is no zip archive ({error}): export it again") from None
    if size > options.limits.expanded_bytes:
        raise AssetError(
            f"{path} unpacks to {size} bytes: make it smaller, or raise ReadLimits.expanded_bytes from "
            f"{options.limits.expanded_bytes}"
        )


def check_picture(head: bytes, name: str, options: ReadOptions) -> None:
    """Check that a PNG picture has no more pixels than the limits allow, by its first 24 bytes; other data passes.

    Raises:
        AssetError: it has more.
    """
    # Width and height are in the IHDR chunk, which is the first of every PNG file.
    if head.startswith(_PNG) and len(head) >= 24:
        width, height = struct.unpack(">II", head[16:24])
        if width * height > options.limits.pixels:
            raise AssetError(
                f"picture {name} has {width} x {height} pixels: make it smaller, or raise ReadLimits.pixels from "
                f"{options.limits.pixels}"
            )
