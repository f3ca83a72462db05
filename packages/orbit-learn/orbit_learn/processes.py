"""Processes that torchrun starts to learn one policy together: how they meet, and means over all of them."""

from __future__ import annotations

import os
from collections.abc import Sequence

import torch
import torch.distributed
from torch import Tensor

from orbit_core.interfaces import ConfigurationError


def started() -> int:
    """Return the number of processes that torchrun started, on all machines together."""
    return int(os.environ.get("WORLD_SIZE", "1"))


def rank() -> int:
    """Return the number of this process among them, from 0."""
    return int(os.environ.get("RANK", "0"))


def met() -> int:
    """Return the number of processes that learn together; 1 before :func:`meet`."""
    return torch.distributed.get_world_size() if torch.distributed.is_initialized() else 1


def meet(device: torch.device) -> None:
    """Wait for the other processes; no-op for one that is alone or has met them.

    Args:
        device: of this process: GPUs exchange tensors by NCCL, CPUs by Gloo.

    Raises:
        ConfigurationError: they cannot be reached.
    """
    if started() == 1 or torch.distributed.is_initialized():
        return
    on_gpu = device.type == "cuda"
    if on_gpu:
        torch.cuda.set_device(device)
    try:
        torch.distributed.init_process_group("nccl" if on_gpu else "gloo")
    except (ValueError, RuntimeError) as error:
        why = " ".join(str(error).split())[:300]
        raise ConfigurationError(
            f"the {started()} processes of this training do not meet ({why}): start them with torchrun, on each "
            "machine with the same --master-addr and --master-port"
        ) from error


def part() -> None:
    """Leave the other processes; no-op for one that is alone."""
    if torch.distributed.is_initialized():
        torch.distributed.destroy_process_group()


def average(tensors: Sequence[Tensor]) -> None:
    """Replace each tensor by its mean over all processes, in place and with one message.

    The order of operations does not depend on values, so that a CUDA graph may hold them.
    """
    if met() == 1:
        return
    # One message: each costs more in waiting than in bytes.
    whole = torch.cat([tensor.detach().flatten() for tensor in tensors])
    torch.distributed.all_reduce(whole)
    whole.div_(met())
    with torch.no_grad():
        for tensor, mean in zip(tensors, whole.split([tensor.numel() for tensor in tensors]), strict=True):
            tensor.copy_(mean.view_as(tensor))


def share(tensors: Sequence[Tensor]) -> None:
    """Give all processes the first one's values, in place."""
    if met() == 1:
        return
    with torch.no_grad():
        for tensor in tensors:
            torch.distributed.broadcast(tensor, src=0)


def standardized(values: Tensor) -> Tensor:
    """Return values, as many in each process, less their mean and over their deviation in all processes."""
    mean = values.mean()
    average([mean])
    squares = (values - mean).square().sum()
    average([squares])
    count = met()
    return (values - mean) / ((squares * count / (values.numel() * count - 1)).sqrt() + 1e-8)
