"""``orbit cache``: archives of compiled kernels fit the versions and GPUs that they were made for, or are rejected."""

from __future__ import annotations

import io
import json
import tarfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import warp as wp

from orbit_core.interfaces import ConfigurationError, UnknownNameError
from orbit_warp.ahead import Launches, compile_modules
from orbit_warp.cache_command import compiled_modules, main, read_archive, write_archive

NAMES = ("wp_kernels_0a1b2c3", "wp_others_4d5e6f7")


def cache_of(folder: Path, archs: tuple[int, ...] = (80, 90)) -> Path:
    """A cache of two modules, each compiled for each architecture, and for the CPU."""
    for name in NAMES:
        module = folder / name
        module.mkdir(parents=True)
        (module / f"{name}.meta").write_text(name)
        (module / f"{name}.cpu0a1b2c3d.o").write_text("x")
        for arch in archs:
            (module / f"{name}.sm{arch}.cubin").write_text(f"{name} {arch}")
    return folder


def archive_of(tmp_path: Path, change: Callable[[dict[str, Any]], None]) -> Path:
    """An archive whose manifest was changed."""
    made, changed = tmp_path / "made.tar.xz", tmp_path / "changed.tar.xz"
    write_archive(made, compiled_modules(cache_of(tmp_path / "from"), 90))
    with tarfile.open(made) as source, tarfile.open(changed, "w:xz") as target:
        for entry in source:
            content: Any = source.extractfile(entry)
            content = content.read()
            if entry.name == "manifest.json":
                manifest = json.loads(content)
                change(manifest)
                content = json.dumps(manifest).encode()
                entry.size = len(content)
            target.addfile(entry, io.BytesIO(content))
    return changed


def test_an_archive_holds_the_modules_of_one_architecture(tmp_path: Path) -> None:
    path = tmp_path / "kernels.tar.xz"
    write_archive(path, compiled_modules(cache_of(tmp_path / "from"), 90))
    assert read_archive(path, tmp_path / "to", {90}) == (2, {90})
    assert sorted(file.name for file in (tmp_path / "to").glob("*/*")) == sorted(
        f"{name}.{end}" for name in NAMES for end in ("meta", "sm90.cubin")
    )
    assert (tmp_path / "to" / NAMES[0] / f"{NAMES[0]}.sm90.cubin").read_text() == f"{NAMES[0]} 90"
    # A machine without a GPU may be where a machine's image is made.
    assert read_archive(path, tmp_path / "to", set()) == (2, {90})


def test_an_archive_of_other_hardware_or_versions_is_rejected(tmp_path: Path) -> None:
    path = archive_of(tmp_path, lambda manifest: None)
    with pytest.raises(ConfigurationError, match=r"for sm_90, and this machine's GPU is sm_80: orbit cache build"):
        read_archive(path, tmp_path / "to", {80})
    other = archive_of(tmp_path / "versions", lambda manifest: manifest["versions"].update({"warp-lang": "1.2.3"}))
    with pytest.raises(ConfigurationError, match=r"warp-lang 1.2.3 and mujoco-warp .*, which warp-lang"):
        read_archive(other, tmp_path / "to", {90})
    other = archive_of(tmp_path / "format", lambda manifest: manifest.update({"kernels": 2}))
    with pytest.raises(ConfigurationError, match="has format 2"):
        read_archive(other, tmp_path / "to", {90})
    assert not (tmp_path / "to").exists()


def test_a_file_that_is_no_archive_is_rejected(tmp_path: Path) -> None:
    path = tmp_path / "kernels.tar.xz"
    path.write_text("nothing")
    with pytest.raises(ConfigurationError, match="no archive of 'orbit cache export'"):
        read_archive(path, tmp_path / "to", set())
    with pytest.raises(ConfigurationError, match="no archive of 'orbit cache export'"):
        read_archive(tmp_path / "missing.tar.xz", tmp_path / "to", set())
    cut = archive_of(tmp_path, lambda manifest: None)
    cut.write_bytes(cut.read_bytes()[:200])
    with pytest.raises(ConfigurationError, match="no archive of 'orbit cache export'"):
        read_archive(cut, tmp_path / "to", set())
    without = archive_of(tmp_path / "without", lambda manifest: manifest.pop("versions"))
    with pytest.raises(ConfigurationError, match="no archive of 'orbit cache export'"):
        read_archive(without, tmp_path / "to", set())


@pytest.mark.parametrize("name", ["../wp_a/wp_a.sm90.cubin", "wp_a/../../x", "/wp_a/wp_a.meta", "wp_a/wp_a.so"])
def test_an_archive_writes_compiled_modules_into_the_cache_only(name: str, tmp_path: Path) -> None:
    path = archive_of(tmp_path, lambda manifest: None)
    with tarfile.open(path) as source, tarfile.open(tmp_path / "bad.tar.xz", "w:xz") as target:
        manifest: Any = source.next()
        target.addfile(manifest, source.extractfile(manifest))
        target.addfile(tarfile.TarInfo(name))
    with pytest.raises(ConfigurationError, match="is no compiled module"):
        read_archive(tmp_path / "bad.tar.xz", tmp_path / "to", set())
    assert not list(tmp_path.glob("to/**/*"))


def test_the_commands_say_what_is_wrong(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(wp.config, "kernel_cache_dir", str(tmp_path))
    with pytest.raises(UnknownNameError, match="export"):
        main(["exprot"])
    with pytest.raises(UnknownNameError, match="Lift"):
        main(["build", "Lfit", "--arch", "90"])
    with pytest.raises(ConfigurationError, match=r"arch is 13: this Warp compiles for 75"):
        main(["build", "Lift", "--arch", "13"])
    with pytest.raises(ConfigurationError, match=r"holds no kernels for sm_90: orbit cache build TASK --arch 90"):
        main(["export", str(tmp_path / "kernels.tar.xz"), "--arch", "90"])
    with pytest.raises(ConfigurationError, match="name the tasks"):
        main(["build"])


@wp.kernel(module="unique")
def _double(values: wp.array(dtype=float)):  # pyright: ignore[reportInvalidTypeForm, reportUnknownParameterType]
    i = wp.tid()
    values[i] = 2.0 * values[i]


def test_kernels_are_compiled_for_a_gpu_that_is_not_here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(wp.config, "kernel_cache_dir", str(tmp_path))
    launches, lines = Launches(), []
    launches.found[_double.module, 256] = None
    for expected in ("1 of 1 modules compiled", "0 of 1 modules compiled"):
        compile_modules(launches, 90, 2, lines.append)
        assert f"sm_90: {expected}" in lines[-1]
    (module,) = compiled_modules(tmp_path)
    assert module.arch == 90
    assert module.binary.stat().st_size > 500
