"""The GPU library is installed by a command that verifies it, and downloaded by nothing else."""

from __future__ import annotations

import hashlib
import io
import threading
import zipfile
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path

import pytest
import torch

from orbit_core import backends
from orbit_core.interfaces import ConfigurationError, SceneLayout
from orbit_core.scene import Scene
from orbit_sapien import physx_gpu

LIBRARY = b"not really a library"


def zipped(name: str) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        archive.writestr(zipfile.ZipInfo(name), LIBRARY)  # of a fixed date, so that each process has the same checksum
    return buffer.getvalue()


FILES = {"/good.zip": zipped("lib/libPhysXGpu_64.so"), "/empty.zip": zipped("readme"), "/torn.zip": b"PK torn"}


class Files(BaseHTTPRequestHandler):
    def do_GET(self) -> None:
        content = FILES.get(self.path)
        self.send_response(404 if content is None else 200)
        self.end_headers()
        self.wfile.write(content or b"")

    def log_message(self, *_: object) -> None:
        pass


@pytest.fixture
def server() -> Iterator[str]:
    serving = HTTPServer(("127.0.0.1", 0), Files)
    thread = threading.Thread(target=serving.serve_forever, daemon=True)
    thread.start()
    yield f"http://127.0.0.1:{serving.server_port}"
    serving.shutdown()
    thread.join()
    serving.server_close()


@pytest.fixture(autouse=True)
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("HOME", str(tmp_path))
    return tmp_path


def checksum(name: str) -> str:
    return hashlib.sha256(FILES[name]).hexdigest()


def test_an_archive_of_the_right_checksum_is_installed_where_sapien_looks(server: str, home: Path) -> None:
    arguments = ["install", "--url", f"{server}/good.zip", "--sha256", checksum("/good.zip").upper()]
    assert physx_gpu.main(arguments) == 0
    assert physx_gpu.library_path().read_bytes() == LIBRARY
    assert physx_gpu.library_path().is_relative_to(home / ".sapien" / "physx")
    assert [path.name for path in physx_gpu.library_path().parent.iterdir()] == ["libPhysXGpu_64.so"]


def test_without_a_checksum_it_is_told_and_nothing_is_installed(
    server: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert physx_gpu.main(["install", "--url", f"{server}/good.zip"]) == 2
    output = capsys.readouterr()
    assert f"{server}/good.zip" in output.out
    assert checksum("/good.zip") in output.out
    assert "--sha256" in output.err
    assert not physx_gpu.library_path().exists()


@pytest.mark.parametrize(
    ("name", "sha256", "complaint"),
    [
        ("/good.zip", "0" * 64, "nothing was installed"),
        ("/empty.zip", checksum("/empty.zip"), "holds no libPhysXGpu_64.so"),
        ("/torn.zip", checksum("/torn.zip"), "no zip archive"),
        ("/lost.zip", "0" * 64, "cannot be downloaded.*404"),
    ],
)
def test_anything_else_leaves_nothing_behind(server: str, name: str, sha256: str, complaint: str) -> None:
    with pytest.raises(ConfigurationError, match=complaint):
        physx_gpu.install(server + name, sha256)
    assert not physx_gpu.library_path().exists()


def test_a_cuda_device_without_the_library_is_refused_with_the_remedy(
    monkeypatch: pytest.MonkeyPatch, home: Path
) -> None:
    monkeypatch.setattr(physx_gpu.physx, "enable_gpu", lambda: pytest.fail("this would download the library"))
    plugin = backends.backend("sapien")
    with pytest.raises(ConfigurationError, match=r"libPhysXGpu_64\.so.*orbit_sapien\.physx_gpu install.*device 'cpu'"):
        plugin.create_engine(SceneLayout.of(Scene()), 1, torch.device("cuda"), plugin.config_type())
    assert not (home / ".sapien").exists()
