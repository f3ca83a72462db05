"""What compressed files hold, measured before anything is unpacked."""

from __future__ import annotations

import struct
import zipfile
from pathlib import Path

from orbit_assets.options import ReadOptions
from orbit_core.interfaces.errors import AssetError

_PNG = b"\x89PNG\r\n\x1a\n"


def check_archive(path: Path, options: ReadOptions) -> None:
    """Hold a zip archive (USDZ, ZAE, 3MF) to unpack to no more than the limits allow.

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
    """Hold a PNG picture to no more pixels than the limits allow, by its first 24 bytes; other data passes.

    Raises:
        AssetError: it has more.
    """
    if head.startswith(_PNG) and len(head) >= 24:
        width, height = struct.unpack(">II", head[16:24])
        if width * height > options.limits.pixels:
            raise AssetError(
                f"picture {name} has {width} x {height} pixels: make it smaller, or raise ReadLimits.pixels from "
                f"{options.limits.pixels}"
            )
