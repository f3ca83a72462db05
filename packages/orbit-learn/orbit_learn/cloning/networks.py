"""Networks of cloned policies: each plans a chunk of actions, of which the first are executed before it plans again.

Chunks decide: with the same data and network, one step at a time lifts none of 64 cubes, a chunk of 16 actions of
which 8 are executed lifts 63. A demonstrator's pauses are part of a chunk, and one step at a time cannot see them.
"""

from __future__ import annotations

import itertools
import math
from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, cast

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from orbit_learn.cloning.encoding import Encoder, Encoding, Labels
from orbit_learn.memory import Memory, MemoryModule
from orbit_learn.networks import perceptron

_MOST_UNITS, _MOST_CHUNK, _MOST_LAYERS = 8192, 512, 16
# Of a mixture's components: without it a likelihood grows without bounds on data that repeat.
_LEAST_DEVIATION = 1e-2


@dataclass(frozen=True, kw_only=True)
class ClonedNetwork:
    """Base of the networks of cloned policies."""

    encoding: Encoding
    """Form in which observation and action are shown to the network."""
    chunk: int = 16
    """H, actions that are planned at a time."""
    executed: int = 8
    """Actions of a plan that are executed before the next one is made."""

    def __post_init__(self) -> None:
        if not 0 < self.executed <= self.chunk <= _MOST_CHUNK:
            raise ValueError(f"executed is 1 to chunk, and chunk at most {_MOST_CHUNK}: {self.executed}, {self.chunk}")


def _check_sizes(**sizes: tuple[int, int]) -> None:
    """Reject sizes outside of 1 to a bound.

    Raises:
        ValueError: names the size.
    """
    for name, (size, most) in sizes.items():
        if not 0 < size <= most:
            raise ValueError(f"{name} is 1 to {most}, not {size}")


@dataclass(frozen=True, kw_only=True)
class ClonedPerceptron(ClonedNetwork):
    """Linear layers; with several modes their plan is a mixture of Gaussians."""

    name: ClassVar[str] = "cloned_perceptron"
    """Word for this kind in policy files."""
    hidden_sizes: tuple[int, ...] = (256, 256)
    """Units of the hidden layers."""
    modes: int = 1
    """Gaussians of the mixture; 1 for a plan fitted by its absolute error."""

    def __post_init__(self) -> None:
        super().__post_init__()
        _check_sizes(modes=(self.modes, 64), layers=(len(self.hidden_sizes), _MOST_LAYERS))
        for size in self.hidden_sizes:
            _check_sizes(hidden_sizes=(size, _MOST_UNITS))

    def build(self, observation_size: int, action_size: int) -> nn.Module:
        """Return the planner; what it sees is as large as the encoding says."""
        return PerceptronPlanner(self, action_size)


@dataclass(frozen=True, kw_only=True)
class ClonedRecurrent(ClonedNetwork):
    """Long short-term memory over the observations of an episode."""

    name: ClassVar[str] = "cloned_recurrent"
    """Word for this kind in policy files."""
    hidden_size: int = 256
    """Units of each recurrent layer."""
    layers: int = 2
    """Recurrent layers."""
    horizon: int = 16
    """Steps after which the memory begins again, as in training (Mandlekar et al., What Matters in Learning from
    Offline Human Demonstrations for Robot Manipulation, 2021)."""
    modes: int = 1
    """Gaussians of the mixture; 1 for a plan fitted by its absolute error."""

    def __post_init__(self) -> None:
        super().__post_init__()
        _check_sizes(
            hidden_size=(self.hidden_size, _MOST_UNITS), layers=(self.layers, _MOST_LAYERS),
            horizon=(self.horizon, 4096), modes=(self.modes, 64),
        )  # fmt: skip

    def build(self, observation_size: int, action_size: int) -> nn.Module:
        """Return the planner; what it sees is as large as the encoding says."""
        return RecurrentPlanner(self, action_size)


@dataclass(frozen=True, kw_only=True)
class ClonedTransformer(ClonedNetwork):
    """Action chunking with transformers.

    Zhao et al., Learning Fine-Grained Bimanual Manipulation with Low-Cost Hardware (2023).
    """

    name: ClassVar[str] = "cloned_transformer"
    """Word for this kind in policy files."""
    width: int = 64
    """Numbers of a token."""
    heads: int = 4
    """Heads of attention, which divide the width."""
    encoder_layers: int = 2
    """Layers over the tokens of the observation."""
    decoder_layers: int = 1
    """Layers over the tokens of the plan."""
    latent: int = 16
    """Size of the variable that explains what differs between demonstrations of one situation; zero when it acts."""
    kl_weight: float = 10.0
    """Weight of that variable's divergence from a normal distribution in the loss."""
    ensemble: float | None = None
    """Where given, a plan is made at every step, and plans for one moment are averaged with weights
    ``exp(-ensemble * age)``, the oldest with 1."""

    def __post_init__(self) -> None:
        super().__post_init__()
        _check_sizes(
            width=(self.width, 1024), heads=(self.heads, 64), encoder_layers=(self.encoder_layers, _MOST_LAYERS),
            decoder_layers=(self.decoder_layers, _MOST_LAYERS), latent=(self.latent, 1024),
        )  # fmt: skip
        if self.width % (2 * self.heads):
            raise ValueError(f"width {self.width} is a multiple of twice the {self.heads} heads")

    def build(self, observation_size: int, action_size: int) -> nn.Module:
        """Return the planner; what it sees is as large as the encoding says."""
        return TransformerPlanner(self, action_size)


@dataclass(frozen=True, kw_only=True)
class ClonedDiffusion(ClonedNetwork):
    """Diffusion policy: Chi et al., Diffusion Policy (2023), with the deterministic sampler of Song et al., Denoising
    Diffusion Implicit Models (2021), and the squared cosine schedule."""  # fmt: skip

    name: ClassVar[str] = "cloned_diffusion"
    """Word for this kind in policy files."""
    width: int = 512
    """Units of the denoiser's hidden layers."""
    layers: int = 3
    """Hidden layers of the denoiser."""
    noises: int = 100
    """Levels of noise in training."""
    samples: int = 10
    """Steps in which a plan is sampled."""
    draws: int = 64
    """Noises that the plans of an episode begin with, in turn."""

    def __post_init__(self) -> None:
        super().__post_init__()
        _check_sizes(width=(self.width, _MOST_UNITS), layers=(self.layers, _MOST_LAYERS), noises=(self.noises, 10_000))
        _check_sizes(samples=(self.samples, min(self.noises, 1000)), draws=(self.draws, 10_000))

    def build(self, observation_size: int, action_size: int) -> nn.Module:
        """Return the planner; what it sees is as large as the encoding says."""
        return DiffusionPlanner(self, action_size)


class Planner(MemoryModule):
    """Policy that plans ``chunk`` actions and executes ``executed`` of them; it remembers the plan and its place in it.

    Args:
        network: that it is built from.
        action_size: A.
    """

    def __init__(self, network: ClonedNetwork, action_size: int) -> None:
        super().__init__()
        self.network = network
        self.action_size = action_size
        self.encoder = Encoder(network.encoding)
        """Normalised features of an observation."""
        self.labels = Labels(network.encoding, action_size)
        """Conversion between actions and the network's outputs."""

    @abstractmethod
    def outputs(self, features: Tensor, memory: Memory) -> Tensor:
        """Return the plan (N, H, A) as labels: normalised, signs as logits.

        Args:
            features: (N, F) of the observation.
            memory: of the step before.
        """

    @abstractmethod
    def loss(self, observation: Tensor | Mapping[str, Tensor], actions: Tensor, valid: Tensor) -> Tensor:
        """Return the loss of a batch.

        Args:
            observation: (B, O), or a dictionary of terms (B, ...); with a dimension of time after B for planners whose
                :attr:`sequence` is above 1.
            actions: (B, H, A) of the demonstrator from then on; likewise.
            valid: (B, H) bool, false beyond the episode's end; likewise.
        """

    sequence: int = 1
    """Consecutive observations of a sample."""

    def initial_memory(self, count: int, device: torch.device | str) -> Memory:
        size = (count, self.network.chunk, self.action_size)
        step = torch.full((count,), self.network.executed, dtype=torch.int64, device=device)
        return {"plan": torch.zeros(size, device=device), "step": step}

    def act(self, observation: Tensor | Mapping[str, Tensor], memory: Memory) -> tuple[Tensor, Memory]:
        made = None
        # Exported graphs plan at every step, for they hold no branches.
        if torch.onnx.is_in_onnx_export() or bool(self.due(memory).any()):
            outputs = self.outputs(self.encoder(observation), memory)
            made = self.labels.actions(outputs, self.encoder.vectors(observation))
        return self.followed(made, memory)

    def due(self, memory: Memory) -> Tensor:
        """Return (N,) bool, true where the plan is executed and a new one is due."""
        return memory["step"] >= self.network.executed

    def followed(self, made: Tensor | None, memory: Memory) -> tuple[Tensor, Memory]:
        """Return the next actions (N, A) of plans, and the plans with their places.

        Args:
            made: new plans (N, H, A), taken where one is due; None where none is.
            memory: of the step before.
        """
        plan, step = memory["plan"], memory["step"]
        if made is not None:
            due = self.due(memory)
            plan, step = torch.where(due[:, None, None], made, plan), torch.where(due, 0, step)
        return _row(plan, step), {"plan": plan, "step": step + 1}

    def errors(self, outputs: Tensor, labels: Tensor, valid: Tensor) -> Tensor:
        """Return the loss of plans (B, H, A) against labels: absolute errors, and cross-entropy of signs."""
        wrong = F.binary_cross_entropy_with_logits(outputs, (labels > 0.0).float(), reduction="none")
        each = torch.where(self.labels.signs, wrong, (outputs - labels).abs())
        return (each.mean(-1) * valid).sum() / valid.sum()


def _row(plan: Tensor, step: Tensor) -> Tensor:
    """Return (N, A), of plans (N, H, A) the action at place ``step`` (N,)."""
    return plan.gather(1, step[:, None, None].expand(-1, 1, plan.shape[2]))[:, 0]


class PlanHead(nn.Module):
    """Last layer: a plan, or a mixture of Gaussians over plans.

    Args:
        width: of what it reads.
        planner: whose plans it makes.
        modes: K.
    """

    def __init__(self, width: int, planner: Planner, modes: int) -> None:
        super().__init__()
        self._chunk, self._actions, self._modes = planner.network.chunk, planner.action_size, modes
        size = self._chunk * self._actions
        self.layer = nn.Linear(width, size if modes == 1 else modes * (2 * size + 1))
        """Linear layer to all plans, their weights and deviations."""

    def plan(self, hidden: Tensor) -> Tensor:
        """Return (N, H, A); of a mixture the mean of its likeliest component."""
        if self._modes == 1:
            return self.layer(hidden).unflatten(1, (self._chunk, self._actions))
        likelihoods, means, _ = self._mixture(hidden)
        return _row(means.flatten(2), likelihoods.argmax(1)).unflatten(1, (self._chunk, self._actions))

    def loss(self, hidden: Tensor, labels: Tensor, valid: Tensor, planner: Planner) -> Tensor:
        """Return the loss of plans for ``hidden`` (B, W) against labels (B, H, A)."""
        if self._modes == 1:
            return planner.errors(self.plan(hidden), labels, valid)
        likelihoods, means, deviations = self._mixture(hidden)
        labels = labels[:, None]
        density = -0.5 * ((labels - means) / deviations).square() - deviations.log()
        logits = F.logsigmoid(torch.where(labels > 0.0, means, -means))
        each = torch.where(planner.labels.signs, logits, density) * valid[:, None, :, None]
        whole = each.sum((2, 3)) / (valid.sum(1)[:, None] * self._actions)
        return -torch.logsumexp(F.log_softmax(likelihoods, 1) + whole, 1).mean()

    def _mixture(self, hidden: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Return logits (B, K), means and deviations (B, K, H, A)."""
        size = self._chunk * self._actions
        outputs = self.layer(hidden).unflatten(1, (self._modes, 2 * size + 1))
        shape = (self._chunk, self._actions)
        means, spread = outputs[..., 1 : size + 1].unflatten(2, shape), outputs[..., size + 1 :].unflatten(2, shape)
        return outputs[..., 0], means, F.softplus(spread) + _LEAST_DEVIATION


class PerceptronPlanner(Planner):
    """Planner of :class:`ClonedPerceptron`."""

    def __init__(self, network: ClonedPerceptron, action_size: int) -> None:
        super().__init__(network, action_size)
        *hidden, last = network.hidden_sizes
        self.layers = nn.Sequential(perceptron(self.encoder.size, hidden, last, nn.ReLU), nn.ReLU())
        """Hidden layers."""
        self.head = PlanHead(last, self, network.modes)
        """Last layer."""

    def outputs(self, features: Tensor, memory: Memory) -> Tensor:
        return self.head.plan(self.layers(features))

    def loss(self, observation: Tensor | Mapping[str, Tensor], actions: Tensor, valid: Tensor) -> Tensor:
        labels = self.labels.normalised(actions, self.encoder.vectors(observation))
        return self.head.loss(self.layers(self.encoder(observation)), labels, valid, self)


class RecurrentPlanner(Planner):
    """Planner of :class:`ClonedRecurrent`: it sees every observation, and plans when its plan is executed."""

    def __init__(self, network: ClonedRecurrent, action_size: int) -> None:
        super().__init__(network, action_size)
        self._network = network
        self.sequence = network.horizon
        self.lstm = nn.LSTM(self.encoder.size, network.hidden_size, network.layers, batch_first=True)
        """Recurrent layers over the features."""
        self.head = PlanHead(network.hidden_size, self, network.modes)
        """Last layer."""

    def initial_memory(self, count: int, device: torch.device | str) -> Memory:
        size = (count, self._network.layers, self._network.hidden_size)
        seen = torch.zeros(count, dtype=torch.int64, device=device)
        hidden = {name: torch.zeros(size, device=device) for name in ("hidden", "cell")}
        return {**super().initial_memory(count, device), **hidden, "seen": seen}

    def outputs(self, features: Tensor, memory: Memory) -> Tensor:
        return self.head.plan(features)

    def act(self, observation: Tensor | Mapping[str, Tensor], memory: Memory) -> tuple[Tensor, Memory]:
        # The memory begins again when a plan is due, never within one.
        again = (memory["seen"] >= self._network.horizon) & self.due(memory)
        kept = (~again).float()[:, None, None]
        state = tuple((memory[name] * kept).transpose(0, 1).contiguous() for name in ("hidden", "cell"))
        seen, (hidden, cell) = self.lstm(self.encoder(observation)[:, None], state)
        made = self.labels.actions(self.head.plan(seen[:, 0]), self.encoder.vectors(observation))
        action, plans = self.followed(made, memory)
        count = torch.where(again, 0, memory["seen"]) + 1
        return action, {**plans, "hidden": hidden.transpose(0, 1), "cell": cell.transpose(0, 1), "seen": count}

    def loss(self, observation: Tensor | Mapping[str, Tensor], actions: Tensor, valid: Tensor) -> Tensor:
        batch, length = actions.shape[:2]
        if isinstance(observation, Tensor):
            rows: Tensor | dict[str, Tensor] = observation.flatten(0, 1)
        else:
            rows = {name: value.flatten(0, 1) for name, value in observation.items()}
        hidden, _ = self.lstm(self.encoder(rows).unflatten(0, (batch, length)))
        labels = self.labels.normalised(actions.flatten(0, 1), self.encoder.vectors(rows))
        return self.head.loss(hidden.flatten(0, 1), labels, valid.flatten(0, 1), self)


class TransformerPlanner(Planner):
    """Planner of :class:`ClonedTransformer`."""

    def __init__(self, network: ClonedTransformer, action_size: int) -> None:
        super().__init__(network, action_size)
        self._network = network
        width, chunk = network.width, network.chunk
        kind = {"dim_feedforward": 4 * width, "dropout": 0.0, "batch_first": True}
        if network.encoding.pictures:
            # Otherwise their features grow at once, for the layers behind divide by their size: those of 400
            # demonstrations of Lift were 33 in the mean and nearly the same in all pictures, and no plan was learned.
            self.pictured = nn.LayerNorm(self.encoder.size - network.encoding.feature_size)
            """Normalisation of the features of pictures."""
        self.observed = nn.Linear(self.encoder.size, width)
        """Linear layer from the features to a token."""
        self.latent = nn.Linear(network.latent, width)
        """Linear layer from the latent variable to a token."""
        self.queries = nn.Parameter(torch.zeros(chunk, width))
        """(H, width) learned token of each action of the plan."""
        self.places = nn.Parameter(torch.zeros(2, width))
        """(2, width) learned offsets of the tokens of observation and latent variable."""
        nn.init.normal_(self.queries, std=0.02)
        nn.init.normal_(self.places, std=0.02)
        encoder, decoder, style = (
            nn.TransformerEncoderLayer(width, network.heads, **kind),
            nn.TransformerDecoderLayer(width, network.heads, **kind),
            nn.TransformerEncoderLayer(width, network.heads, **kind),
        )
        self.reader = nn.TransformerEncoder(encoder, network.encoder_layers, enable_nested_tensor=False)
        """Encoder over both tokens."""
        self.writer = nn.TransformerDecoder(decoder, network.decoder_layers)
        """Decoder from the queries to the plan."""
        self.head = nn.Linear(width, action_size)
        """Linear layer from a token to an action."""
        # Of training alone: what a demonstration has done, as a latent variable.
        # As deep as the decoder: it reads a whole chunk, which takes most of a gradient step's time.
        self.style = nn.TransformerEncoder(style, network.decoder_layers, enable_nested_tensor=False)
        """Encoder over a demonstrated chunk; used in training only."""
        self.shown = nn.Linear(action_size, width)
        """Linear layer from a demonstrated action to a token; used in training only."""
        self.style_places = nn.Parameter(torch.zeros(chunk + 2, width))
        """(H + 2, width) learned offsets of the tokens of ``style``."""
        nn.init.normal_(self.style_places, std=0.02)
        self.moments = nn.Linear(width, 2 * network.latent)
        """Linear layer to mean and logarithmic variance of the latent variable; used in training only."""

    def initial_memory(self, count: int, device: torch.device | str) -> Memory:
        if self._network.ensemble is None:
            return super().initial_memory(count, device)
        size = (count, self.network.chunk)
        sums = torch.zeros((*size, self.action_size), device=device)
        return {"sums": sums, "weights": torch.zeros(size, device=device), "plans": torch.zeros(size, device=device)}

    def outputs(self, features: Tensor, memory: Memory) -> Tensor:
        return self._decoded(features, features.new_zeros(features.shape[0], self._network.latent))

    def act(self, observation: Tensor | Mapping[str, Tensor], memory: Memory) -> tuple[Tensor, Memory]:
        if self._network.ensemble is None:
            return super().act(observation, memory)
        outputs = self.outputs(self.encoder(observation), memory)
        plan = self.labels.actions(outputs, self.encoder.vectors(observation))
        weight = (-self._network.ensemble * memory["plans"]).exp()
        sums, weights, plans = (
            memory["sums"] + weight[..., None] * plan,
            memory["weights"] + weight,
            memory["plans"] + 1,
        )
        action = sums[:, 0] / weights[:, 0, None]
        action = torch.where(self.labels.signs, torch.where(action < 0.0, -1.0, 1.0), action)
        # All plans move on by a step; the last place is new to them.
        moved = {"sums": sums, "weights": weights, "plans": plans}
        return action, {name: torch.cat((v[:, 1:], torch.zeros_like(v[:, :1])), 1) for name, v in moved.items()}

    def loss(self, observation: Tensor | Mapping[str, Tensor], actions: Tensor, valid: Tensor) -> Tensor:
        features = self.encoder(observation)
        labels = self.labels.normalised(actions, self.encoder.vectors(observation))
        tokens = (self._token(features)[:, None], self.shown(labels * valid[..., None]))
        first = torch.zeros_like(tokens[0])
        seen = self._styled(torch.cat((first, *tokens), 1) + self.style_places)
        mean, log_variance = self.moments(seen).chunk(2, 1)
        latent = mean + torch.randn_like(mean) * (0.5 * log_variance).exp()
        divergence = -0.5 * (1.0 + log_variance - mean.square() - log_variance.exp()).sum(1).mean()
        outputs = self._decoded(features, latent)
        return self.errors(outputs, labels, valid) + self._network.kl_weight * divergence

    def _token(self, features: Tensor) -> Tensor:
        """Return the token (N, W) of an observation's features (N, F)."""
        if self._network.encoding.pictures:
            begin = self._network.encoding.feature_size
            features = torch.cat((features[:, :begin], self.pictured(features[:, begin:])), 1)
        return self.observed(features)

    def _decoded(self, features: Tensor, latent: Tensor) -> Tensor:
        tokens = self.reader(torch.stack((self._token(features), self.latent(latent)), 1) + self.places)
        first, *others = cast("list[nn.TransformerDecoderLayer]", list(self.writer.layers))
        # The first layer's queries are the same in all rows until they have looked at the tokens.
        queries = _attended(first.self_attn, first.norm1, self.queries[None])
        # Sizes by shape: an exported graph keeps len() as a constant.
        queries = queries.expand(features.shape[0], -1, -1)
        plan = _transformed(first, first.norm3, _attended(first.multihead_attn, first.norm2, queries, tokens))
        for layer in others:
            plan = layer(plan, tokens)
        return self.head(plan)

    def _styled(self, tokens: Tensor) -> Tensor:
        """Return the first token (B, W) of ``style`` over ``tokens`` (B, H + 2, W)."""
        *others, last = cast("list[nn.TransformerEncoderLayer]", list(self.style.layers))
        for layer in others:
            tokens = layer(tokens)
        # The last layer for that token only, for the others are not read.
        return _transformed(last, last.norm2, _attended(last.self_attn, last.norm1, tokens[:, :1], tokens))[:, 0]


def _attended(
    attention: nn.MultiheadAttention, norm: nn.LayerNorm, queries: Tensor, tokens: Tensor | None = None
) -> Tensor:
    """Return queries (B, Q, W) after attention to ``tokens`` (B, T, W), or to themselves, added and normalised."""
    read = queries if tokens is None else tokens
    return norm(queries + attention(queries, read, read, need_weights=False)[0])


def _transformed(
    layer: nn.TransformerEncoderLayer | nn.TransformerDecoderLayer, norm: nn.LayerNorm, tokens: Tensor
) -> Tensor:
    """Return tokens (B, T, W) after the linear layers of a layer of a transformer, added and normalised."""
    return norm(tokens + layer.linear2(F.relu(layer.linear1(tokens))))


class DiffusionPlanner(Planner):
    """Planner of :class:`ClonedDiffusion`. It predicts the clean plan.

    The plans of an episode begin with the noises of a list in turn: an episode can be repeated, and where demonstrators
    differ, or wait by time, each plan draws again what to do. From one noise for all plans, a policy that draws "wait"
    in a state that waiting does not change waits there until the episode ends: 25, 80 and 73 of 100 succeeded in Lift
    where 99, 100 and 100 do (the same weights, of three trainings from 400 demonstrations).
    """

    noise: Tensor
    """(D, H, A) that sampling begins with."""

    def __init__(self, network: ClonedDiffusion, action_size: int) -> None:
        super().__init__(network, action_size)
        self._network = network
        size = network.chunk * action_size
        self.register_buffer("noise", torch.randn(network.draws, network.chunk, action_size))
        hidden = (network.width,) * network.layers
        self.layers = perceptron(self.encoder.size + size + 2 * _TIMES, hidden, size, nn.ReLU)
        """Denoiser, from features, noisy plan and level of noise to the clean plan."""

    def initial_memory(self, count: int, device: torch.device | str) -> Memory:
        drawn = torch.zeros(count, dtype=torch.int64, device=device)
        return {**super().initial_memory(count, device), "drawn": drawn}

    def act(self, observation: Tensor | Mapping[str, Tensor], memory: Memory) -> tuple[Tensor, Memory]:
        action, plans = super().act(observation, memory)
        drawn = (memory["drawn"] + self.due(memory)) % self._network.draws
        return action, {**plans, "drawn": drawn}

    def outputs(self, features: Tensor, memory: Memory) -> Tensor:
        count = features.shape[0]  # len() would be a constant of an exported graph
        plan = self.noise.index_select(0, memory["drawn"])
        noises, samples = self._network.noises, self._network.samples
        levels = [round(i * noises / samples) for i in range(samples, -1, -1)]
        for level, following in itertools.pairwise(levels):
            kept, next_kept = self._kept(level), self._kept(following)
            clean = self._clean(features, plan, features.new_full((count,), level / noises))
            noise = (plan - math.sqrt(kept) * clean) / math.sqrt(1.0 - kept)
            plan = math.sqrt(next_kept) * clean + math.sqrt(1.0 - next_kept) * noise
        return plan

    def loss(self, observation: Tensor | Mapping[str, Tensor], actions: Tensor, valid: Tensor) -> Tensor:
        features = self.encoder(observation)
        labels = self.labels.normalised(actions, self.encoder.vectors(observation))
        time = torch.randint(1, self._network.noises + 1, (len(labels),), device=labels.device) / self._network.noises
        # Half of the plans are noise alone, where sampling begins and features alone tell the plan: after 8,000 updates
        # from 400 demonstrations of Lift plans are 0.097 deviations from the demonstrator's, and 0.114 where levels are
        # drawn evenly and the first step size is 1e-3.
        time = torch.where(torch.rand_like(time) < 0.5, 1.0, time)
        kept = _squared_cosine(time)[:, None, None]
        noisy = kept.sqrt() * labels + (1.0 - kept).sqrt() * torch.randn_like(labels)
        wrong = (self._clean(features, noisy, time) - labels).abs().mean(-1)
        return (wrong * valid).sum() / valid.sum()

    def _clean(self, features: Tensor, plan: Tensor, time: Tensor) -> Tensor:
        """Return the plan (N, H, A) without the noise of level ``time`` (N,) in [0, 1]."""
        phases = time[:, None] * math.pi * torch.arange(1, _TIMES + 1, device=time.device)
        inputs = torch.cat((features, plan.flatten(1), phases.sin(), phases.cos()), 1)
        return self.layers(inputs).view_as(plan)

    def _kept(self, level: int) -> float:
        return float(_squared_cosine(torch.tensor(level / self._network.noises)))


# Waves that show a level of noise to the network.
_TIMES = 16


def _squared_cosine(time: Tensor) -> Tensor:
    """Return the share of a plan's variance that is left at a level of noise in [0, 1]: Nichol and Dhariwal, Improved
    Denoising Diffusion Probabilistic Models (2021)."""  # fmt: skip
    offset = 0.008
    start = math.cos(offset / (1.0 + offset) * math.pi / 2.0) ** 2
    return (((time + offset) / (1.0 + offset) * math.pi / 2.0).cos().square() / start).clamp(1e-4, 0.9999)
