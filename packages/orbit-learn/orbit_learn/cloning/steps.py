"""Gradient steps of cloning, recorded as one graph on a GPU."""

from __future__ import annotations

import copy
from typing import Any

import torch
from torch import Tensor, nn

from orbit_learn.cloning.demonstrations import Demonstrations
from orbit_learn.cloning.networks import Planner
from orbit_learn.memory import map_seen
from orbit_learn.recorded import RecordedFunction
from orbit_learn.trainer import half_cosine

_MOST_GRADIENT = 1.0
_SHIFT = 4
"""Pixels that pictures are shifted by in training."""
# Of the free memory of a device: demonstrations leave room for gradients, and for other trainings on the device.
_MOST_SHARE = 0.5


class GradientSteps:
    """Gradient steps of a planner. The learning rate falls to zero along half a cosine.

    Demonstrations are moved to the planner's device once, and the samples of an iteration are drawn together, so that a
    step waits for nothing: on a GPU it is one launch of a graph, and Python's part of it is a call.

    Args:
        planner: that learns, on its device.
        samples: windows in a step; a planner of sequences takes as many windows in sequences of its length.
        steps: in an iteration.
        total: steps of the whole training, over which the rate falls.
        learning_rate: step size of AdamW at the beginning.
        seed: of the samples.
        recorded: False runs each operation from Python on a GPU too.
    """

    def __init__(
        self, planner: Planner, samples: int, steps: int, total: int, learning_rate: float, seed: int,
        recorded: bool = True,
    ) -> None:  # fmt: skip
        self._planner, self._total, self._initial, self._seed = planner, total, learning_rate, seed
        self._recorded = recorded
        self._device = device = planner.labels.mean.device
        self._weights = list(planner.parameters())
        # A tensor, because the recorded step changes it.
        self._rate = torch.tensor(learning_rate, device=device)
        self._optimizer = torch.optim.AdamW(
            self._weights, self._rate, weight_decay=1e-6, fused=True, capturable=device.type == "cuda"
        )
        self._generator = torch.Generator().manual_seed(seed)
        self._sequence = torch.arange(planner.sequence, device=device)
        # Read and written by each step at the place that is on the device: a recorded step always finds its own.
        self._rates = torch.zeros(steps, device=device)
        self._rows = torch.zeros(steps, max(1, samples // planner.sequence), dtype=torch.int64, device=device)
        self._place = torch.zeros(1, dtype=torch.int64, device=device)
        self._losses = torch.zeros((), device=device)

    def show(self, demonstrations: Demonstrations) -> None:
        """Learn from these demonstrations from now on."""
        fits = (
            self._device.type != "cuda" or demonstrations.bytes < _MOST_SHARE * torch.cuda.mem_get_info(self._device)[0]
        )
        self._shown = demonstrations.to(self._device) if fits else demonstrations
        self._record()

    def run(self, iteration: int) -> float:
        """Take the steps of an iteration, and return their mean loss.

        Args:
            iteration: number of the iteration, from 0.
        """
        count = len(self._rates)
        rates = [half_cosine(self._initial, (iteration * count + step) / self._total) for step in range(count)]
        self._rates.copy_(torch.tensor(rates))
        self._rows.copy_(torch.randint(self._shown.steps, self._rows.shape, generator=self._generator))
        self._place.zero_()
        self._losses.zero_()
        self._planner.train()
        for _ in range(count):
            self._step()
        self._planner.eval()
        return float(self._losses) / count

    def state(self) -> Any:
        """Return the optimiser's state."""
        return self._optimizer.state_dict()

    def restore(self, state: Any, iteration: int) -> None:
        """Continue after an iteration whose end had this state."""
        groups = self._optimizer.state_dict()["param_groups"]
        # Copied, for loading keeps tensors of the same device as they are.
        self._optimizer.load_state_dict({"state": copy.deepcopy(state["state"]), "param_groups": groups})
        self._optimizer.param_groups[0]["lr"] = self._rate  # of which loading has made a copy
        # Another seed for each iteration: a resumed training must not repeat the samples of its beginning.
        self._generator.manual_seed(self._seed + iteration + 1)
        self._record()

    def _record(self) -> None:
        """Record the step again: its tensors have moved."""
        # Demonstrations that stay on the host are copied in each step, which no graph can hold.
        held = self._shown.actions.device == self._device
        self._step = RecordedFunction(self._descend, self._device) if held and self._recorded else self._descend

    def _descend(self) -> None:
        """Take one gradient step."""
        self._find_gradients()
        self._rate.copy_(self._rates.index_select(0, self._place)[0])
        self._optimizer.step()
        self._place += 1

    def _find_gradients(self) -> None:
        """Compute the gradients of the step's windows."""
        loss = self._planner.loss(*self._batch())
        self._planner.zero_grad()
        loss.backward()
        nn.utils.clip_grad_norm_(self._weights, _MOST_GRADIENT)
        # Summed on the device: reading each loss would wait for it.
        self._losses += loss.detach()

    def _batch(self) -> tuple[Tensor | dict[str, Tensor], Tensor, Tensor]:
        """Return observations, actions and validity of the step's windows, see :meth:`Planner.loss`."""
        shown, device = self._shown, self._device
        rows = self._rows.index_select(0, self._place)[0].to(shown.actions.device)
        if self._planner.sequence > 1:
            # Sequences stay within their episode; near its end its last steps repeat.
            sequence = self._sequence.to(rows.device)
            rows = torch.minimum(rows[:, None] + sequence, shown.ends[rows][:, None])
        actions, valid = shown.windows(rows, self._planner.network.chunk)
        seen = map_seen(lambda value: shifted(value.to(device)), shown.observed(rows))
        return seen, actions.to(device), valid.to(device)


def shifted(value: Tensor) -> Tensor:
    """Return pictures (..., H, W, C) shifted by up to ``_SHIFT`` pixels each way, their edges repeated; else the value.

    Why: Kostrikov et al., Image Augmentation Is All You Need (2021); a network of few pictures learns their pixels.
    """
    if value.dim() < 4:
        return value
    pictures = value.flatten(0, -4)  # of sequences too
    count, height, width = pictures.shape[:3]
    shift = torch.randint(-_SHIFT, _SHIFT + 1, (2, count, 1), device=value.device)
    rows = (torch.arange(height, device=value.device) + shift[0]).clamp(0, height - 1)
    columns = (torch.arange(width, device=value.device) + shift[1]).clamp(0, width - 1)
    each = torch.arange(count, device=value.device)[:, None, None]
    return pictures[each, rows[:, :, None], columns[:, None, :]].view_as(value)
