"""A real rosbridge server (``rosbridge-server-rs``) on the ROS 2 of the registry's wheels, for tests."""

from __future__ import annotations

import os
import socket
import subprocess
import sysconfig
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from tests.deploy.rig import eventually
from tests.ros.rig import listens

# Python of an environment with `ros-rclpy[fastrtps]`, its messages and `rosbridge-server-rs` from the registry
ROS2_PYTHON = os.environ.get("ORBIT_ROS2_PYTHON", "")
_PROGRAM = "rosbridge_server_rs/rosbridge_server_rs_jazzy"


def missing() -> str:
    """Return what lacks for the server; empty if nothing does."""
    if not ROS2_PYTHON:
        return "capability 'ROS 2' (rclpy) is not named by ORBIT_ROS2_PYTHON"
    if not _packages().joinpath(_PROGRAM).is_file():
        return "rosbridge-server-rs is not installed in the environment of ORBIT_ROS2_PYTHON"
    return "" if _python_library() is not None else "the shared library of Python is not installed"


@contextmanager
def rosbridge(domain: int, folder: Path) -> Iterator[int]:
    """Run the server in a DDS domain of this machine, and yield its port."""
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        port = found.getsockname()[1]
    prefix = Path(ROS2_PYTHON).parent.parent
    # The wheels have no dispatcher of middlewares, whose place the only one can take.
    (folder / "librmw_implementation.so").symlink_to(prefix / "lib" / "librmw_fastrtps_cpp.so")
    libraries = [folder, prefix / "lib", *_packages().glob("ros_*.libs")]
    environment = {
        "LD_LIBRARY_PATH": ":".join(map(str, libraries)), "LD_PRELOAD": str(_python_library()), "HOME": str(folder),
        "AMENT_PREFIX_PATH": str(prefix), "ROS_DOMAIN_ID": str(domain), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
    }  # fmt: skip
    program = folder / "rosbridge_server"
    # Its mode is lost in the wheel.
    program.write_bytes(_packages().joinpath(_PROGRAM).read_bytes())
    program.chmod(0o700)
    words = [str(program), "--no-rosapi", "--bind", f"127.0.0.1:{port}", "--log-level", "error"]
    with subprocess.Popen(words, env=environment, stdout=subprocess.DEVNULL) as running:
        try:
            assert eventually(lambda: listens(port), 20.0)
            yield port
        finally:
            running.terminate()


def _packages() -> Path:
    return next(iter((Path(ROS2_PYTHON).parent.parent / "lib").glob("python3*/site-packages")), Path("none"))


def _python_library() -> Path | None:
    name = f"{_packages().parent.name.replace('python', 'libpython')}.so"
    folders = [Path(sysconfig.get_config_var("LIBDIR") or "/usr/lib"), *Path("/usr/lib").glob("*-linux-gnu")]
    return next((each for folder in folders for each in sorted(folder.glob(f"{name}*"))), None)
