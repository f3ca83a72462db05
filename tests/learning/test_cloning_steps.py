"""Gradient steps of cloning: the same as a plain loop's, and without anything that a recorded graph cannot hold."""

from __future__ import annotations

import copy
from dataclasses import replace
from typing import Any

import pytest
import torch
from torch import Tensor, nn
from torch.overrides import TorchFunctionMode
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves

from orbit_learn.cloning.demonstrations import Demonstrations
from orbit_learn.cloning.encoding import Encoding
from orbit_learn.cloning.networks import (
    ClonedDiffusion,
    ClonedNetwork,
    ClonedPerceptron,
    ClonedRecurrent,
    ClonedTransformer,
    Planner,
    TransformerPlanner,
)
from orbit_learn.cloning.steps import GradientSteps, shifted
from orbit_learn.description import Part
from orbit_learn.memory import map_seen
from orbit_learn.networks import convolutional
from orbit_learn.recorded import RecordedFunction
from orbit_learn.trainer import half_cosine

ENCODING = Encoding(
    (Part("joints", 2), Part("cube", 7), Part("goal", 3), Part("last_action", 3)), hidden=(12, 13, 14), vectors=(2, 9),
    rotations=(5,),
    joints=(0, 1, -1), gains=(0.5, 2.0, 0.0), biases=(0.1, 0.0, 0.0), binary=(False, False, True),
)  # fmt: skip
SHARED: dict[str, Any] = {"encoding": ENCODING, "chunk": 4, "executed": 2}
FRONT = Part("front", 16 * 16 * 3, (16, 16, 3), "uint8")
SEEING = replace(
    ENCODING, parts=(*ENCODING.parts, FRONT), concatenated=False, pictures=convolutional((FRONT,), ()).encoders
)
NETWORKS: tuple[ClonedNetwork, ...] = (
    ClonedPerceptron(**SHARED, hidden_sizes=(16, 16)),
    ClonedPerceptron(**SHARED, hidden_sizes=(16, 16), modes=2),
    ClonedRecurrent(**SHARED, hidden_size=8, horizon=4),
    ClonedTransformer(**SHARED, width=16, heads=2, encoder_layers=2, decoder_layers=2),
    ClonedDiffusion(**SHARED, width=16),
    ClonedPerceptron(**{**SHARED, "encoding": SEEING}, hidden_sizes=(16,)),
    ClonedRecurrent(**{**SHARED, "encoding": SEEING}, hidden_size=8, horizon=4),
    ClonedTransformer(**{**SHARED, "encoding": SEEING}, width=16, heads=2),
)
BATCH, STEPS, TOTAL, RATE = 8, 3, 12, 1e-2
META = torch.device("meta")


def name_of(network: ClonedNetwork) -> str:
    seeing = "-pictures" if network.encoding.pictures else ""
    return f"{type(network).name}-{getattr(network, 'modes', 1)}{seeing}"  # pyright: ignore[reportAttributeAccessIssue]


def planner_of(network: ClonedNetwork) -> Planner:
    torch.manual_seed(0)
    planner = network.build(ENCODING.vector_size, 3)  # pyright: ignore[reportAttributeAccessIssue]
    assert isinstance(planner, Planner)
    return planner


def demonstrations(encoding: Encoding = ENCODING, count: int = 40) -> Demonstrations:
    torch.manual_seed(1)
    ends = torch.arange(count) // 10 * 10 + 9
    actions = torch.rand(count, 3) * 2.0 - 1.0
    if encoding.concatenated:
        return Demonstrations(torch.randn(count, encoding.vector_size), actions, ends)
    seen = {part.name: torch.randn(count, part.size) for part in encoding.parts if not part.is_picture}
    pictures = {FRONT.name: torch.randint(0, 256, (count, 16, 16, 3), dtype=torch.uint8)}
    return Demonstrations({**seen, **pictures}, actions, ends)


def plain_loop(planner: Planner, shown: Demonstrations, iterations: int) -> list[float]:
    """Learn as a textbook does it, one sample of one step after another; return the mean loss of each iteration."""
    optimizer = torch.optim.AdamW(planner.parameters(), RATE, weight_decay=1e-6)
    generator = torch.Generator().manual_seed(5)
    losses = [0.0] * iterations
    for step in range(iterations * STEPS):
        for group in optimizer.param_groups:
            group["lr"] = half_cosine(RATE, step / TOTAL)
        rows = torch.randint(shown.steps, (BATCH // planner.sequence,), generator=generator)
        if planner.sequence > 1:
            rows = torch.stack([(rows + i).minimum(shown.ends[rows]) for i in range(planner.sequence)], 1)
        loss = planner.loss(map_seen(shifted, shown.observed(rows)), *shown.windows(rows, planner.network.chunk))
        optimizer.zero_grad()
        loss.backward()
        nn.utils.clip_grad_norm_(planner.parameters(), 1.0)
        optimizer.step()
        losses[step // STEPS] += float(loss.detach()) / STEPS
    return losses


@pytest.mark.parametrize("network", NETWORKS, ids=name_of)
def test_steps_learn_what_a_plain_loop_learns(network: ClonedNetwork) -> None:
    plain, planner = planner_of(network), planner_of(network)
    shown = demonstrations(network.encoding)
    torch.manual_seed(2)
    expected = plain_loop(plain, shown, 3)
    torch.manual_seed(2)
    steps = GradientSteps(planner, BATCH, STEPS, TOTAL, RATE, 5)
    steps.show(shown)
    found = [steps.run(iteration) for iteration in range(3)]
    assert found == pytest.approx(expected, rel=1e-4)
    # Their plans, for a bias of attention changes no plan, and its gradient is rounding that AdamW makes large.
    begun, learned, wanted = (each.eval()(shown.observation).detach() for each in (planner_of(network), planner, plain))
    torch.testing.assert_close(learned, wanted, rtol=1e-3, atol=1e-4)
    assert float((learned - begun).abs().max()) > 1e-2


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs the capability of a GPU")
@pytest.mark.parametrize("network", NETWORKS, ids=name_of)
def test_a_recorded_step_on_a_gpu_learns_what_a_plain_one_learns(network: ClonedNetwork) -> None:
    shown, plans, losses = demonstrations(network.encoding), [], []
    for recorded in (False, True):
        planner = planner_of(network).cuda()
        steps = GradientSteps(planner, BATCH, 8, 32, RATE, 5, recorded)
        steps.show(shown)
        torch.manual_seed(2)
        losses.append([steps.run(iteration) for iteration in range(4)])
        plans.append(planner(steps._shown.observation).detach())
        assert isinstance(steps._step, RecordedFunction) == recorded
    begun = planner_of(network).cuda().eval()(steps._shown.observation).detach()
    assert float((plans[1] - begun).abs().max()) > 1e-2
    # Noise within the step is another in a graph, and so are shifts of pictures.
    drawn = isinstance(network, ClonedTransformer | ClonedDiffusion) or network.encoding.pictures
    assert losses[0] == pytest.approx(losses[1], rel=0.3 if drawn else 0.01)
    if not drawn:
        torch.testing.assert_close(plans[0], plans[1], rtol=1e-2, atol=1e-2)


def test_steps_go_on_from_their_state_with_other_samples() -> None:
    network, shown = NETWORKS[0], demonstrations()
    planner = planner_of(network)
    steps = GradientSteps(planner, BATCH, STEPS, TOTAL, RATE, 5)
    steps.show(shown)
    steps.run(0)
    state, weights = copy.deepcopy(steps.state()), copy.deepcopy(planner.state_dict())

    def resumed(iteration: int) -> dict[str, Tensor]:
        other = planner_of(network)
        other.load_state_dict(weights)
        later = GradientSteps(other, BATCH, STEPS, TOTAL, RATE, 5)
        later.show(shown)
        later.restore(state, iteration)
        later.run(1)
        return {**other.state_dict(), "moment": later.state()["state"][0]["exp_avg"]}

    first, again, other = resumed(0), resumed(0), resumed(1)
    assert all(torch.equal(first[name], again[name]) for name in first)
    assert not torch.equal(first["moment"], other["moment"]), "samples follow from the iteration"
    assert not torch.equal(first["moment"], state["state"][0]["exp_avg"]), "the optimiser goes on"


def test_a_transformer_skips_what_is_not_read_and_gives_the_same() -> None:
    planner = planner_of(NETWORKS[3])
    assert isinstance(planner, TransformerPlanner)
    tokens = torch.randn(5, 6, 16)
    torch.testing.assert_close(planner._styled(tokens), planner.style(tokens)[:, 0])
    features, latent = torch.randn(5, planner.encoder.size), torch.randn(5, 16)
    read = planner.reader(torch.stack((planner.observed(features), planner.latent(latent)), 1) + planner.places)
    whole = planner.head(planner.writer(planner.queries.expand(5, -1, -1), read))
    torch.testing.assert_close(planner._decoded(features, latent), whole)


def test_a_transformer_sees_pictures_whatever_the_size_of_their_features() -> None:
    planner = planner_of(ClonedTransformer(**{**SHARED, "encoding": SEEING}, width=16, heads=2)).eval()
    torch.manual_seed(3)
    vectors = torch.randn(5, SEEING.feature_size)
    pictures = torch.randn(5, planner.encoder.size - SEEING.feature_size)

    def plans(scale: float, offset: float) -> Tensor:
        features = torch.cat((vectors, scale * pictures + offset), 1)
        return planner.outputs(features, planner.initial_memory(5, "cpu"))

    # Grown by a thousand they would leave nothing of the joints, or, with an offset, of what differs between them.
    torch.testing.assert_close(plans(1000.0, 5000.0), plans(1.0, 0.0), rtol=1e-3, atol=1e-3)


class Operations(TorchDispatchMode):
    """Rejects operations that read a tensor of another device, or wait for one: a recorded graph can hold neither."""

    def __init__(self) -> None:
        super().__init__()
        self.count = 0

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        read = [each for each in tree_leaves((args, kwargs or {})) if isinstance(each, Tensor) and each.dim()]
        assert all(each.is_meta for each in read), f"{func} reads a tensor of the host"
        assert func is not torch.ops.aten._local_scalar_dense.default, "a number is read"
        self.count += 1
        return func(*args, **(kwargs or {}))


class Constructions(TorchFunctionMode):
    """Rejects tensors and indices made of Python's lists, which would be copied from the host in each step."""

    def __torch_function__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        assert func not in (torch.tensor, torch.as_tensor, Tensor.new_tensor), f"{func} copies from the host"
        index = args[1] if func is Tensor.__getitem__ else ()
        assert not any(isinstance(each, list) for each in (index if isinstance(index, tuple) else (index,))), (
            "a list is copied from the host"
        )
        return func(*args, **(kwargs or {}))


@pytest.mark.parametrize("network", NETWORKS, ids=name_of)
def test_a_step_touches_nothing_of_the_host(network: ClonedNetwork) -> None:
    planner = planner_of(network)
    steps = GradientSteps(planner, BATCH, STEPS, TOTAL, RATE, 5)
    steps.show(demonstrations(network.encoding))
    # The meta device has shapes only, so that it is here on any machine.
    planner.to("meta")
    steps._device, steps._shown, steps._weights = META, steps._shown.to(META), list(planner.parameters())
    for name in ("_rows", "_place", "_sequence", "_losses"):
        setattr(steps, name, getattr(steps, name).to(META))
    with Constructions(), Operations() as operations:
        steps._find_gradients()
    assert operations.count > 50
    assert all(each.grad is not None for each in steps._weights)


def test_the_check_of_what_a_step_touches_finds_lists_and_numbers() -> None:
    rows = torch.zeros(3, 2, device=META)
    for wrong in (lambda: rows.new_tensor([1.0, 2.0]), lambda: rows[:, [0]], lambda: torch.zeros(2)[0].item()):
        with Constructions(), Operations(), pytest.raises(AssertionError, match=r"the host|a number is read"):
            wrong()
