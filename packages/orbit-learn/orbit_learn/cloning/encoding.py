"""Observation and action as a cloned policy sees them.

Three things decide whether cloning works, measured on Lift with joint position targets of 2 rad per unit. Labels are
relative to the present joint positions: an error of 8e-4 of a unit is some 4 cm at the hand otherwise. Differences of
positions are also shown in centimetres, through ``tanh``: 49 successes of 64 with them, 18 without. And rotations are
shown without the sign of their quaternion.
"""

from __future__ import annotations

import bisect
import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from orbit_core.interfaces import ConfigurationError
from orbit_data.manifest.manifest import ActionTermManifest, Manifest, ObservationTermManifest
from orbit_learn.description import Part
from orbit_learn.networks import Convolutional, PictureEncoder, convolutional, encoded_pictures

FINE = 0.03
"""Metres at which a fine difference saturates: the width of a small object."""
# Least standard deviation of a feature: one that hardly changes in the data must not become huge outside of it.
_LEAST_STD = 1e-2
_LEAST_LABEL_STD = 1e-3
_MOST_DEVIATIONS = 10.0
_LAST_ACTION = "last_action"
_GRIPPER = "binary_gripper"
# Beginnings of terms' formulas.
_POSITIONS, _VELOCITIES = "measured position of each joint", "measured velocity of each joint"
_SEVERAL = "positions of "
# Of a term whose columns are several positions, such as the key points of a cloth; more are shown as they are.
_MOST_POSITIONS = 12
_MOST_VECTORS = 32
# Six numbers of the matrix and two quaternions.
_ROTATION_FEATURES = 14
# A turn within a quarter, as a vector.
_QUARTER_FEATURES = 3
# Metres or radians by which the measured positions of a gripper's joints are disturbed in training.
_BLUR = 0.002


@dataclass(frozen=True)
class Encoding:
    """Encoding of a cloned policy's observation, and reference of its action; plain data for a policy's file."""

    parts: tuple[Part, ...]
    """Terms of the observation, in order."""
    concatenated: bool = True
    """True if the terms are side by side in one tensor; False for a dictionary of them."""
    hidden: tuple[int, ...] = ()
    """Columns that the network does not see: the last action, which it would learn to copy, and velocities of a
    gripper's joints, which engines report differently where contacts stop them."""
    vectors: tuple[int, ...] = ()
    """First columns of positions and distances (3 columns in metres), of which fine differences are shown, but of those
    within a term, such as the key points of a cloth."""
    rotations: tuple[int, ...] = ()
    """First columns of unit quaternions (4 columns; w, x, y, z), shown as ``rotation_features`` in their place."""
    joints: tuple[int, ...] = ()
    """Column of the joint position that each component of the action is relative to; -1 for none. Empty for none."""
    gains: tuple[float, ...] = ()
    """Units of action for a unit of that column."""
    biases: tuple[float, ...] = ()
    """Action where that column is zero."""
    binary: tuple[bool, ...] = ()
    """Components of the action of which only the sign counts, such as a gripper's. Empty for none."""
    pictures: tuple[PictureEncoder, ...] = ()
    """Encoders of the terms that are pictures."""
    quarters: bool = False
    """True to show rotations within a quarter turn as well, see ``quarter_features``."""
    blurred: tuple[int, ...] = ()
    """Columns of the positions of a gripper's joints, disturbed in training: where contacts stop them, engines differ
    by a millimetre."""

    def __post_init__(self) -> None:
        size = self.vector_size
        columns = (*self.hidden, *self.vectors, *self.blurred, *(column for column in self.joints if column != -1))
        ends = (*(column + 3 for column in self.vectors), *(column + 4 for column in self.rotations))
        if any(not 0 <= column < size for column in (*columns, *self.rotations)) or any(end > size for end in ends):
            raise ValueError(f"an encoding's columns are 0 to {size - 1}")
        if not len(self.joints) == len(self.gains) == len(self.biases):
            raise ValueError("joints, gains and biases are as many as components of the action")
        if len(self.vectors) > _MOST_VECTORS:
            raise ValueError(f"an encoding shows fine differences of up to {_MOST_VECTORS} positions")

    @property
    def vector_size(self) -> int:
        """O, columns of the terms that are no pictures."""
        return sum(part.size for part in self.parts if not part.is_picture)

    @property
    def feature_size(self) -> int:
        """F, numbers that the network sees in addition to features of pictures."""
        count, pairs = len(self.vectors), len(self.pairs)
        turns = _ROTATION_FEATURES + _QUARTER_FEATURES * self.quarters
        shown = self.vector_size - len(self.replaced) + turns * len(self.rotations)
        return shown + 3 * pairs + 3 * (count + pairs)

    @property
    def pairs(self) -> tuple[tuple[int, int], ...]:
        """Places in ``vectors`` of the positions whose difference is shown: those of different terms."""
        ends = list(itertools.accumulate(part.size for part in self.parts if not part.is_picture))
        terms = [bisect.bisect(ends, column) for column in self.vectors]
        return tuple(pair for pair in itertools.combinations(range(len(terms)), 2) if terms[pair[0]] != terms[pair[1]])

    @property
    def replaced(self) -> frozenset[int]:
        """Columns that the network does not see as they are."""
        return frozenset((*self.hidden, *(first + i for first in self.rotations for i in range(4))))


def encoding_for(manifest: Manifest, group: str, parts: tuple[Part, ...], concatenated: bool) -> Encoding:
    """Return the encoding for an environment's observation group and action, by what its manifest says of them.

    Args:
        manifest: of the environment that the demonstrations were recorded in.
        group: observation group that the policy sees.
        parts: its terms, as a policy's description lists them.
        concatenated: whether they are side by side.
    """
    terms = manifest.observations[group].terms
    columns: dict[str, int] = {}
    begin = 0
    for part in parts:
        if not part.is_picture:
            columns[part.name] = begin
            begin += part.size
    hidden = [c for p in parts if p.name == _LAST_ACTION for c in range(columns[p.name], columns[p.name] + p.size)]
    hidden += _of_gripper(manifest, terms, columns, _VELOCITIES)
    vectors = [
        columns[name] + 3 * i for name, term in terms.items() if name in columns for i in range(_positions_in(term))
    ]
    rotations = [columns[name] + 3 for name, term in terms.items() if name in columns and _is_pose(term)]
    joints: list[int] = []
    gains: list[float] = []
    biases: list[float] = []
    binary: list[bool] = []
    for action in manifest.action_terms.values():
        binary += [action.generator == _GRIPPER] * len(action.components)
        for i, joint in enumerate(action.components):
            column, gain, bias = _relative(action, i, joint, terms, columns)
            joints.append(column)
            gains.append(gain)
            biases.append(bias)
    pictures = () if concatenated else convolutional(parts, ()).encoders
    return Encoding(
        parts, concatenated, tuple(hidden), tuple(vectors), tuple(rotations), tuple(joints), tuple(gains),
        tuple(biases), tuple(binary), pictures, bool(rotations), _of_gripper(manifest, terms, columns, _POSITIONS),
    )  # fmt: skip


def _positions_in(term: ObservationTermManifest) -> int:
    """Return how many positions or distances in metres, of three columns each, a term begins with."""
    if not _is_plain(term):
        return 0
    if _is_pose(term):
        return 1
    several = term.formula.startswith(_SEVERAL) and len(term.shape) == 1 and term.shape[0] % 3 == 0
    if term.unit != "m" or not (several or tuple(term.shape) == (3,)):
        return 0
    count = term.shape[0] // 3
    return count if count <= _MOST_POSITIONS else 0


def _is_plain(term: ObservationTermManifest) -> bool:
    """Return True if a term is one measurement in its own unit."""
    return term.history == 1 and term.scale == 1.0


def _is_pose(term: ObservationTermManifest) -> bool:
    """Return True if a term is a position and a quaternion."""
    return _is_plain(term) and term.unit.startswith("m, quaternion") and tuple(term.shape) == (7,)


def _of_gripper(
    manifest: Manifest, terms: Mapping[str, ObservationTermManifest], columns: Mapping[str, int], measured: str
) -> tuple[int, ...]:
    """Return the columns of a measurement of joints that only a binary gripper moves, and of joints that follow them.

    Args:
        manifest: of the environment.
        terms: of the observation group.
        columns: first column of each term.
        measured: beginning of the formula of the terms, ``_POSITIONS`` or ``_VELOCITIES``.
    """
    actions = manifest.action_terms.values()
    if not any(action.generator == _GRIPPER for action in actions):
        return ()
    others = {joint for action in actions if action.generator != _GRIPPER for joint in action.joints}
    return tuple(
        columns[name] + place
        for name, term in terms.items()
        if name in columns and _measures(term, measured)
        for place, joint in enumerate(term.components)
        if joint not in others
    )


def _measures(term: ObservationTermManifest, measured: str) -> bool:
    """Return True if each column of a term is a measurement of one joint now."""
    return term.formula.startswith(measured) and term.history == 1


def _relative(
    action: ActionTermManifest,
    component: int,
    joint: str,
    terms: Mapping[str, ObservationTermManifest],
    columns: Mapping[str, int],
) -> tuple[int, float, float]:
    """Return the column of a joint's position, and the action that commands this very position as a line over it."""
    if action.scale is None or action.offset is None or action.settings.get("mode") != "absolute":
        return -1, 0.0, 0.0
    for name, term in terms.items():
        if name in columns and _measures(term, _POSITIONS) and term.offset and joint in term.components:
            place = list(term.components).index(joint)
            gain = 1.0 / action.scale[component]
            # observed = scale * (position - its offset); commanded position = offset + scale * action
            bias = (term.offset[place] - action.offset[component]) * gain
            return columns[name] + place, gain / term.scale, bias
    return -1, 0.0, 0.0


def rotation_features(quaternions: Tensor) -> Tensor:
    """Return (..., 14) features of unit quaternions (..., 4), equal for both quaternions of a rotation.

    The first two columns of the matrix (Zhou et al., On the Continuity of Rotation Representations in Neural Networks,
    2019), then the cosine, and the axis times the sine, of twice and of four times the angle. These repeat with every
    half and quarter turn, as grasps of boxes do, which a network does not learn from the angle and few demonstrations
    (Tancik et al., Fourier Features Let Networks Learn High Frequency Functions in Low Dimensional Domains, 2020).
    """
    w, x, y, z = quaternions.unbind(-1)
    # Not by quat_to_matrix: the exporter of ONNX would keep the number of rows of what it unflattens.
    rows = (
        1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z),
        2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z),
        2.0 * (x * z - w * y), 2.0 * (y * z + w * x),
    )  # fmt: skip
    columns = torch.stack(rows, -1)
    # A quaternion holds half the angle.
    twice = _squared(_squared(quaternions))
    return torch.cat((columns, twice, _squared(twice)), -1)


def quarter_features(quaternions: Tensor) -> Tensor:
    """Return (..., 3) the axis times the angle, in quarter turns, of unit quaternions (..., 4) modulo quarter turns.

    It jumps at an eighth of a turn, where the nearest pair of a box's faces changes. A network that is shown continuous
    features only may average both choices next to that jump, and the hand stops between the faces.
    """
    turned = _squared(_squared(quaternions))
    # The sign of a quaternion is free; the real part is made positive for the shorter way.
    turned = torch.where(turned[..., :1] < 0.0, -turned, turned)
    axis = turned[..., 1:]
    length = axis.norm(dim=-1, keepdim=True).clamp_min(1e-9)
    return axis / length * torch.atan2(length, turned[..., :1])


def _squared(quaternions: Tensor) -> Tensor:
    """Return quaternions (..., 4) of twice the angle about the same axis."""
    w, axis = quaternions[..., :1], quaternions[..., 1:]
    return torch.cat((w.square() - axis.square().sum(-1, keepdim=True), 2.0 * w * axis), -1)


def _keep(module: nn.Module, name: str, values: Sequence[object], kind: torch.dtype) -> None:
    """Give a module a constant tensor that moves with it and is no weight of a policy's file.

    A tensor made of a list in every call would be copied to the device each time, which a recorded graph cannot hold.
    """
    # On the CPU even while weights are made on torch's meta device: no file would fill it.
    module.register_buffer(name, torch.tensor(values, dtype=kind, device="cpu"), persistent=False)


class Encoder(nn.Module):
    """Features of an observation, normalised, with those of its pictures.

    Args:
        encoding: that says what is seen.
    """

    mean: Tensor
    """(F,) of features in the demonstrations."""
    std: Tensor
    """(F,) theirs."""
    shown: Tensor
    """(S,) columns that are shown as they are."""
    turned: Tensor
    """(4 R,) columns of the quaternions."""
    places: Tensor
    """(3 V,) columns of the positions."""
    blurred: Tensor
    """(B,) columns that are disturbed in training."""
    firsts: Tensor
    """(P,) positions that are subtracted."""
    seconds: Tensor
    """(P,) positions that they are subtracted from."""

    def __init__(self, encoding: Encoding) -> None:
        super().__init__()
        self.encoding = encoding
        shown = [column for column in range(encoding.vector_size) if column not in encoding.replaced]
        pairs = encoding.pairs
        _keep(self, "shown", shown, torch.int64)
        _keep(self, "turned", [begin + i for begin in encoding.rotations for i in range(4)], torch.int64)
        _keep(self, "places", [begin + axis for begin in encoding.vectors for axis in range(3)], torch.int64)
        _keep(self, "blurred", encoding.blurred, torch.int64)
        _keep(self, "firsts", [first for first, _ in pairs], torch.int64)
        _keep(self, "seconds", [second for _, second in pairs], torch.int64)
        self.register_buffer("mean", torch.zeros(encoding.feature_size))
        self.register_buffer("std", torch.ones(encoding.feature_size))
        self._convolutional = None
        self.size = encoding.feature_size
        """Numbers that :meth:`forward` gives."""
        if encoding.pictures:
            vectors = tuple(part for part in encoding.parts if not part.is_picture)
            self._convolutional = Convolutional(encoding.pictures, vectors, ())
            self.pictures = self._convolutional.build_encoders()
            """Convolutions of each set of pictures."""
            self.size += self._convolutional.features

    def vectors(self, observation: Tensor | Mapping[str, Tensor]) -> Tensor:
        """Return (N, O) the terms that are no pictures, side by side."""
        if isinstance(observation, Tensor):
            return observation
        terms = [part.name for part in self.encoding.parts if not part.is_picture]
        return torch.cat([observation[name].float().flatten(1) for name in terms], dim=1)

    def features(self, vectors: Tensor) -> Tensor:
        """Return (N, F) features of ``vectors`` (N, O), before they are normalised."""
        # All terms of a kind in one operation each: on a GPU a step takes as long as it has operations.
        seen = [vectors.index_select(1, self.shown)]
        if self.encoding.rotations:
            quaternions = vectors.index_select(1, self.turned).view(vectors.shape[0], -1, 4)
            seen.append(rotation_features(quaternions).flatten(1))
            if self.encoding.quarters:
                seen.append(quarter_features(quaternions).flatten(1))
        if self.encoding.vectors:
            places = vectors.index_select(1, self.places).view(vectors.shape[0], -1, 3)
            differences = places.index_select(1, self.seconds) - places.index_select(1, self.firsts)
            fine = (torch.cat((places, differences), dim=1) / FINE).tanh()
            seen += [differences.flatten(1), fine.flatten(1)]
        return torch.cat(seen, dim=1)

    def forward(self, observation: Tensor | Mapping[str, Tensor]) -> Tensor:
        vectors = self.vectors(observation)
        if self.training and self.encoding.blurred:
            noise = _BLUR * torch.randn(len(vectors), len(self.encoding.blurred), device=vectors.device)
            vectors = vectors.index_add(1, self.blurred, noise)
        features = (self.features(vectors) - self.mean) / self.std
        features = features.clamp(-_MOST_DEVIATIONS, _MOST_DEVIATIONS)
        if self._convolutional is None:
            return features
        assert not isinstance(observation, Tensor)
        return torch.cat((features, encoded_pictures(self._convolutional, self.pictures, observation)), dim=1)

    def fit(self, vectors: Tensor) -> None:
        """Take mean and standard deviation from demonstrations (T, O)."""
        count, total, squares = 0, torch.zeros_like(self.mean), torch.zeros_like(self.mean)
        for rows in vectors.split(65536):
            features = self.features(rows)
            count, total, squares = count + len(rows), total + features.sum(0), squares + features.square().sum(0)
        self.mean.copy_(total / count)
        self.std.copy_((squares / count - self.mean.square()).clamp(min=0.0).sqrt() + _LEAST_STD)


class Labels(nn.Module):
    """Actions as a network's outputs: relative to joint positions, in standard deviations, signs as logits.

    Args:
        encoding: that says what is relative and what is a sign.
        action_size: A.

    Raises:
        ValueError: the encoding is of another number of components.
    """

    mean: Tensor
    """(A,) of relative actions in the demonstrations."""
    std: Tensor
    """(A,) theirs."""
    columns: Tensor
    """(A,) columns of the joint positions that components are relative to; 0 where a component is relative to none."""
    gains: Tensor
    """(A,) units of action for a unit of that column; 0 where a component is relative to none."""
    biases: Tensor
    """(A,) action where that column is zero."""
    signs: Tensor
    """(A,) bool, components that are a sign."""

    def __init__(self, encoding: Encoding, action_size: int) -> None:
        super().__init__()
        for values in (encoding.joints, encoding.binary):
            if values and len(values) != action_size:
                raise ValueError(f"an encoding for {len(values)} components of an action of {action_size}")
        joints = encoding.joints or (-1,) * action_size
        relative = [column != -1 for column in joints]
        none = (0.0,) * action_size
        gains = [gain * used for gain, used in zip(encoding.gains or none, relative, strict=True)]
        biases = [bias * used for bias, used in zip(encoding.biases or none, relative, strict=True)]
        _keep(self, "columns", [max(column, 0) for column in joints], torch.int64)
        _keep(self, "gains", gains, torch.float32)
        _keep(self, "biases", biases, torch.float32)
        _keep(self, "signs", encoding.binary or (False,) * action_size, torch.bool)
        self.register_buffer("mean", torch.zeros(action_size))
        self.register_buffer("std", torch.ones(action_size))

    def base(self, vectors: Tensor) -> Tensor:
        """Return (N, A) actions that command the present joint positions; zero where a component is not relative."""
        return vectors.index_select(1, self.columns) * self.gains + self.biases

    def normalised(self, actions: Tensor, vectors: Tensor) -> Tensor:
        """Return labels (B, H, A) of actions (B, H, A) that began at observations (B, O); signs are -1 and 1."""
        labels = (actions - self.base(vectors)[:, None] - self.mean) / self.std
        return torch.where(self.signs, torch.where(actions < 0.0, -1.0, 1.0), labels)

    def actions(self, outputs: Tensor, vectors: Tensor) -> Tensor:
        """Return actions (N, H, A) in [-1, 1] of a network's outputs (N, H, A), whose signs are logits."""
        actions = outputs * self.std + self.mean + self.base(vectors)[:, None]
        # A gripper without a definite command stays open, as a binary gripper reads zero.
        signs = torch.where(outputs < 0.0, -1.0, 1.0)
        return torch.where(self.signs, signs, actions).clamp(-1.0, 1.0)

    def fit(self, actions: Tensor, vectors: Tensor) -> None:
        """Take mean and standard deviation from windows (B, H, A) that began at observations (B, O).

        Raises:
            ConfigurationError: there is none.
        """
        if not len(actions):
            raise ConfigurationError("there are no demonstrations to take statistics from")
        relative = (actions - self.base(vectors)[:, None]).flatten(0, 1)
        self.mean.copy_(relative.mean(0).where(~self.signs, 0.0))
        self.std.copy_((relative.std(0) + _LEAST_LABEL_STD).where(~self.signs, 1.0))
