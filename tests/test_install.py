"""uv installs what pip is set up to install, and pip does where uv fails."""

from __future__ import annotations

import subprocess
import sys
from types import SimpleNamespace

import pytest

from tools import install

LISTED = """\
:env:.find-links='/own wheels'
:env:.default-timeout='180'
global.extra-index-url='https://a/simple\\nfile:///b/simple'
global.find-links='/wheels'
install.constraint='/etc/caps.txt'
download.index-url='https://elsewhere'
"""


def test_uv_takes_what_pip_is_set_up_to_take_and_variables_go_before_files() -> None:
    assert install.settings_of_pip(LISTED) == {
        "UV_FIND_LINKS": "/own,wheels",
        "UV_HTTP_TIMEOUT": "180",
        "UV_INDEX": "https://a/simple file:///b/simple",
        "UV_CONSTRAINT": "/etc/caps.txt",
    }
    own = install.environment_for_uv(
        LISTED, {"UV_INDEX": "https://mine", "PIP_CACHE_DIR": "/c/pip", "VIRTUAL_ENV": "/x"}
    )
    assert (own["UV_INDEX"], own["UV_CACHE_DIR"], own["VIRTUAL_ENV"]) == ("https://mine", "/c/uv", sys.prefix)


def test_pip_installs_where_uv_fails(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    ran: list[list[str]] = []

    def run(command: list[str], check: bool, **_: object) -> SimpleNamespace:
        ran.append([*command[2:]])
        if check and command[2:4] == ["uv", "pip"]:
            raise subprocess.CalledProcessError(2, command)
        return SimpleNamespace(returncode=0, stdout=LISTED)

    monkeypatch.setattr(install.subprocess, "run", run)
    assert install.install(["--editable", "."]) == 0
    assert ran[-2:] == [
        ["uv", "pip", "install", "--quiet", "--editable", "."],
        ["pip", "install", "--quiet", "--no-compile", "--editable", "."],
    ]
    assert "note: uv pip install failed with 2; pip installs" in capsys.readouterr().err
