"""Checks of the arguments that callers give to a world, made once, before any engine sees them.

Types, shapes, dtypes and devices are always checked: Python knows them. Values are checked where that is free, on a CPU
outside of a traced step. On a GPU a check of values would wait for the device.
"""

from __future__ import annotations

import math
import numbers
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from orbit_core.interfaces import MAX_DISTANCE, MAX_SPEED, ArgumentError, ConfigurationError, NonFiniteError, ShapeError
from orbit_core.interfaces.capture import is_tracing

MOST_ENVIRONMENTS = 2**31 - 1  # engines count in 32 bits
MOST_STEPS = 1_000_000
"""Physics steps in one call, which nothing interrupts before its end."""
_LARGEST_SEED = 2**63 - 1  # seeds are hashed as signed 64-bit integers
# Largest difference of a quaternion's length from 1: engines take care of what is rounded
_UNIT = 1e-3


@dataclass(frozen=True)
class Bounds:
    """Range of accepted numbers, from ``least`` to ``most``."""

    least: float
    most: float
    unit: str = ""
    """Unit for the message."""

    @staticmethod
    def either_way(most: float, unit: str = "") -> Bounds:
        """Return bounds from -``most`` to ``most``."""
        return Bounds(-most, most, unit)


# Bounds are far beyond any robot: they catch mistakes of units and NaN, not unusual tasks.
FINITE = Bounds.either_way(torch.finfo(torch.float32).max)
POSITIONS = Bounds.either_way(MAX_DISTANCE, "m or rad")
VELOCITIES = Bounds.either_way(MAX_SPEED, "m/s or rad/s")
ACCELERATIONS = Bounds.either_way(MAX_SPEED, "m/s^2")
EFFORTS = Bounds.either_way(1e9, "N or N m")
MASSES = Bounds(0.0, 1e9, "kg")
MOVING_MASSES = Bounds(1e-9, 1e9, "kg")
NO_MASS = Bounds(0.0, 0.0, "kg")
FRICTIONS = Bounds(0.0, 1e6)
GAINS = Bounds(0.0, 1e12)
COLORS = Bounds(0.0, 1.0)
RADIANCES = Bounds(0.0, 1e3)
COSINES = Bounds(-1.0001, 1.0001)


def whole_number(value: object, what: str, least: int, most: int) -> int:
    """Return ``value`` if it is a whole number from ``least`` to ``most``; NumPy's count, true and false do not.

    Args:
        value: that a caller gave.
        what: it is, for the message.
        least: smallest that is accepted.
        most: largest that is accepted.

    Raises:
        ArgumentError: it is not.
    """
    # The common case first: this runs at every call.
    if type(value) is int and least <= value <= most:
        return value
    if isinstance(value, bool) or not isinstance(value, numbers.Integral):
        raise ArgumentError(f"{what} must be a whole number, not {_described(value)}")
    number = int(value)
    if number < least:
        raise ArgumentError(f"{what} must be at least {least}, not {number}")
    if number > most:
        raise ArgumentError(f"{what} must be at most {most}, not {number}")
    return number


def seed_number(seed: object) -> int:
    """Return a seed of random streams: 0 to 2^63 - 1.

    Raises:
        ArgumentError: it is none.
    """
    return whole_number(seed, "a seed", 0, _LARGEST_SEED)


def usable_device(device: object) -> torch.device:
    """Return a device of torch's that is there, with its index.

    Raises:
        ConfigurationError: it is none, or not there.
    """
    try:
        return torch.empty(0, device=device).device  # pyright: ignore[reportCallIssue, reportArgumentType]
    except (RuntimeError, TypeError, ValueError, AssertionError) as error:
        reason = str(error).partition("\n")[0]
        raise ConfigurationError(f"device {device!r} cannot be used: {reason}; 'cpu' always can") from None


def columns_chosen(chosen: Iterable[int], count: int, what: str) -> tuple[int, ...]:
    """Check indices of joints or links of an entity, and return them.

    Args:
        chosen: indices that a caller gave.
        count: joints or links of the entity.
        what: they are, for the message.

    Raises:
        ArgumentError: one is no index, out of range or there twice.
    """
    if type(chosen) not in (list, tuple) and (isinstance(chosen, Tensor) or not isinstance(chosen, Iterable)):
        raise ArgumentError(f"{what} are given as a list of indices, such as find_... gives, not {_described(chosen)}")
    indices = tuple(chosen)
    # Without a loop of Python, for controllers choose joints in every physics step.
    if {*map(type, indices)} - {int} or (indices and not 0 <= min(indices) <= max(indices) < count):
        indices = tuple(whole_number(index, f"each of {what}", 0, count - 1) for index in indices)
    if len({*indices}) != len(indices):
        raise ArgumentError(f"{what} {list(indices)} name one twice: name each once")
    return indices


def check_index_values(value: object, device: torch.device, what: str) -> None:
    """Refuse what is no tensor of int64 on the device.

    Raises:
        ArgumentError: it is none.
    """
    if not isinstance(value, Tensor) or value.dtype != torch.int64 or value.device != device:
        raise ArgumentError(f"{what} must be a torch tensor of int64 on {device}, not {_described(value)}")


def check_index_tensor(env_ids: object, num_envs: int, device: torch.device) -> None:
    """Refuse what cannot be indices (n,) int64 of environments, or a mask (N,) bool, by what Python knows of it.

    Raises:
        ArgumentError: another type, dtype or device.
        ShapeError: another shape.
    """
    if not isinstance(env_ids, Tensor):
        raise ArgumentError(f"env_ids must be a torch tensor, not {_described(env_ids)}: use torch.tensor")
    if env_ids.dtype not in (torch.int64, torch.bool) or env_ids.layout is not torch.strided:
        raise ArgumentError(f"env_ids must be dense int64 indices or a bool mask, not {env_ids.dtype}: convert them")
    if env_ids.device != device:
        raise ArgumentError(f"env_ids are on {env_ids.device}, and the world on {device}: move them with .to(...)")
    if env_ids.dim() != 1 or (env_ids.dtype == torch.bool and len(env_ids) != num_envs):
        kind = f"a mask ({num_envs},)" if env_ids.dtype == torch.bool else "a vector (n,)"
        raise ShapeError(f"env_ids must be {kind}, not of shape {tuple(env_ids.shape)}")


def check_indices(env_ids: Tensor, num_envs: int) -> None:
    """Refuse indices (n,) out of range or twice the same; on a GPU this waits for the device once.

    Raises:
        ArgumentError: names the index.
    """
    if env_ids.device.type == "cpu":
        indices = env_ids.tolist()
        if not indices or (min(indices) >= 0 and max(indices) < num_envs and len({*indices}) == len(indices)):
            return
    inside = env_ids.clamp(0, num_envs - 1)
    times = torch.zeros(num_envs, dtype=torch.int64, device=env_ids.device).scatter_add_(
        0, inside, torch.ones_like(env_ids)
    )
    outside, twice = inside != env_ids, times[inside] > 1
    if bool((outside | twice).any()):
        wrong = env_ids[outside] if bool(outside.any()) else env_ids[twice]
        fault = f"and there are {num_envs} environments" if bool(outside.any()) else "twice"
        raise ArgumentError(
            f"env_ids name environment {int(wrong[0])} {fault}: give each index from 0 to {num_envs - 1} once"
        )


def as_floats(value: object, device: torch.device, what: str) -> Tensor:
    """Return numbers as float32 that carry no gradient; float64 and integers are converted.

    Args:
        value: that a caller gave.
        device: of the world.
        what: it is, for the message.

    Raises:
        ArgumentError: it is no dense tensor of real numbers on ``device``; says what to do.
    """
    if not isinstance(value, Tensor):
        raise ArgumentError(f"{what} must be a torch tensor on {device}, not {_described(value)}: use torch.as_tensor")
    if value.layout is not torch.strided:
        raise ArgumentError(f"{what} is a sparse tensor: give {what}.to_dense()")
    if value.device != device:
        raise ArgumentError(f"{what} is on {value.device}, and the world on {device}: move it with .to(world.device)")
    if value.dtype is not torch.float32:
        if value.dtype is torch.bool or value.is_complex() or value.is_quantized:
            raise ArgumentError(f"{what} must hold real numbers, not {value.dtype}: give float32")
        value = value.to(torch.float32)
    return value.detach() if value.requires_grad else value


def check_shape(value: Tensor, expected: tuple[int, ...], what: str) -> None:
    """Refuse another shape.

    Raises:
        ShapeError: names both.
    """
    if tuple(value.shape) != expected:
        raise ShapeError(f"{what} must have shape {expected}, not {tuple(value.shape)}")


def check_numbers(value: Tensor, bounds: Bounds, what: str, env_ids: Tensor | None = None) -> None:
    """Reject NaN and numbers out of bounds; on a GPU no value is checked.

    Args:
        value: (n, ...) numbers of n environments.
        bounds: that they must keep.
        what: they are, for the message.
        env_ids: (n,) the environments' indices; all in order if None.

    Raises:
        NonFiniteError: a number is NaN or infinite; names the environment and the component.
        ArgumentError: a number is out of bounds; names them too.
    """
    if value.device.type != "cpu" or not value.numel() or is_tracing():
        return
    # NumPy's reductions of the tensor's own memory: on few numbers they cost a third of torch's. NaN passes through.
    array = value.numpy()
    if not (bounds.least <= np.minimum.reduce(array, axis=None) and np.maximum.reduce(array, axis=None) <= bounds.most):
        _refuse_number(value, bounds, what, env_ids)


def check_quaternions(poses: Tensor, what: str, env_ids: Tensor | None = None) -> None:
    """Reject poses (n, 7) whose quaternions are not of length 1; on a GPU no value is checked.

    They are not scaled here: a wrong length is a sign of a mistake, such as angles in their place, or an average.

    Raises:
        ArgumentError: a quaternion of another length; names the environment.
    """
    if poses.device.type != "cpu" or not len(poses) or is_tracing():
        return
    lengths = torch.linalg.vector_norm(poses[:, 3:], dim=-1)
    least, most = torch.aminmax(lengths)
    if float(least) < 1.0 - _UNIT or float(most) > 1.0 + _UNIT:
        row = int((lengths - 1.0).abs().argmax())
        raise ArgumentError(
            f"{what} of environment {_environment(row, env_ids)} has a quaternion of length "
            f"{float(lengths[row]):.4g}: give (w, x, y, z) of length 1"
        )


def _refuse_number(value: Tensor, bounds: Bounds, what: str, env_ids: Tensor | None) -> None:
    wrong = (~((value >= bounds.least) & (value <= bounds.most))).nonzero()
    if not len(wrong):  # a bound itself, which is rounded in single precision
        return
    row, *rest = (int(index) for index in wrong[0])
    number = float(value[(row, *rest)])
    component = f" component {', '.join(map(str, rest))}" if rest else ""
    place = f"{what}{component} of environment {_environment(row, env_ids)} is {number:g}"
    if not math.isfinite(number):
        raise NonFiniteError(f"{place}: give finite numbers")
    raise ArgumentError(f"{place}: give {bounds.least:g} to {bounds.most:g} {bounds.unit}".rstrip())


def _environment(row: int, env_ids: Tensor | None) -> int:
    return row if env_ids is None else int(env_ids[row])


def _described(value: object) -> str:
    shown = repr(value)
    return f"{shown if len(shown) < 40 else 'a value'} ({type(value).__name__})"
