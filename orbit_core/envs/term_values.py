"""What reward and termination terms give, held to a value for each environment."""

from __future__ import annotations

from torch import Tensor

from orbit_core.interfaces import ConfigurationError, ShapeError


def per_environment(value: object, what: str, num_envs: int) -> Tensor:
    """A term's value, where it is a tensor (N,).

    Args:
        value: that the term's function gave.
        what: the term, for the message.
        num_envs: N.

    Raises:
        ConfigurationError: it is no tensor.
        ShapeError: it has another shape.
    """
    if not isinstance(value, Tensor):
        raise ConfigurationError(f"{what} gives a {type(value).__name__}: its function must return a torch.Tensor")
    if value.shape != (num_envs,):
        raise ShapeError(
            f"{what} has shape {tuple(value.shape)}, but must have ({num_envs},), a value for each environment"
        )
    return value
