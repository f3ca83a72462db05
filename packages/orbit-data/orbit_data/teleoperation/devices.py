"""Devices by name."""

from __future__ import annotations

from collections.abc import Callable

from orbit_core.installing import install_extra
from orbit_core.interfaces import ConfigurationError, UnknownNameError
from orbit_data.teleoperation.device import Device, Speeds
from orbit_data.teleoperation.driver import Driver


def _browser(speeds: Speeds, driver: Driver, port: int) -> Device:
    try:
        from orbit_data.teleoperation.browser import Browser
    except ImportError:
        raise ConfigurationError(f"the browser needs viser: {install_extra('viewer')}") from None
    return Browser(speeds, driver)


def _keyboard(speeds: Speeds, driver: Driver, port: int) -> Device:
    from orbit_data.teleoperation.keyboard import Keyboard

    return Keyboard(speeds)


def _gamepad(speeds: Speeds, driver: Driver, port: int) -> Device:
    from orbit_data.teleoperation.gamepad import open_gamepad

    return open_gamepad(speeds)


def _spacemouse(speeds: Speeds, driver: Driver, port: int) -> Device:
    from orbit_data.teleoperation.spacemouse import open_spacemouse

    return open_spacemouse(speeds)


def _leader(speeds: Speeds, driver: Driver, port: int) -> Device:
    from orbit_data.teleoperation.leader import Leader

    if driver.hand is None:
        raise ConfigurationError(f"robot '{driver.active}' has no arm that a leader's joint values could move")
    return Leader(driver.hand.robot.joint_names, port)


DEVICES: dict[str, Callable[[Speeds, Driver, int], Device]] = {
    "browser": _browser,
    "keyboard": _keyboard,
    "gamepad": _gamepad,
    "spacemouse": _spacemouse,
    "leader": _leader,
}


def check_device(name: str) -> None:
    """Refuse a name that is no device's.

    Raises:
        UnknownNameError: tells the nearest.
    """
    if name not in DEVICES:
        raise UnknownNameError("device", name, DEVICES)


def open_device(name: str, speeds: Speeds, driver: Driver, leader_port: int) -> Device:
    """Return the device of that name, ready to be read.

    Raises:
        UnknownNameError: there is no such name.
        ConfigurationError: it is not plugged in, or what reads it is not installed.
    """
    check_device(name)
    return DEVICES[name](speeds, driver, leader_port)
