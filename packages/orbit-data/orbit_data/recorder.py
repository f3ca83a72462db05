"""Records episodes of many environments at once, which end when they will, into files that nothing undoes.

While episodes run, all environments' steps lie in rings (steps, N, ...) on the environment's device, to which each step
adds one row. Only when episodes end are their rows gathered, and written.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from orbit_core.envs.observation_groups import POLICY
from orbit_core.interfaces import Object, Robot, ShapeError, UnknownNameError, World
from orbit_core.rollout.stepping import StepObserver
from orbit_core.sensors.contact import ContactSensor
from orbit_data.episodes import (
    ACTIONS,
    CONTACTS,
    DONES,
    INITIAL,
    NEXT,
    OBSERVED,
    POSES,
    REWARDS,
    STATES,
    Array,
    EpisodeInfo,
)
from orbit_data.parts import PartFolder
from orbit_data.states import TaskMemory, WorldStates

if TYPE_CHECKING:
    from orbit_core.envs.captured_step import StepResult
    from orbit_core.envs.environment import Environment, EpisodeEnd
    from orbit_core.envs.observation_layout import GroupLayout, Observation

Wanted = Callable[["EpisodeEnd", Tensor], Tensor]
"""Which of the episodes that ended (n,) are kept, given how often each environment ended one before (n,)."""


def check_groups(groups: Collection[str], environment: Environment) -> None:
    """Refuse observation groups that an environment lacks.

    Raises:
        UnknownNameError: tells the nearest.
    """
    for name in groups:
        if name not in environment.observation:
            raise UnknownNameError("observation group", name, environment.observation)


class DemonstrationRecorder(StepObserver):
    """Writes each finished episode: states, actions, observations, rewards, poses, contacts, and how it began.

    On a GPU each step waits for the device, to know which episodes ended.

    Args:
        environment: that is stepped; its episodes have just begun.
        folder: takes the episodes.
        wanted: which of them.
        seed: that the random streams were started from.
        groups: observation groups to record; all if None.
        begun: (N,) episodes that each environment ended before; none if None.

    Raises:
        UnknownNameError: there is no such group.
    """

    def __init__(
        self,
        environment: Environment,
        folder: PartFolder,
        wanted: Wanted,
        seed: int,
        groups: Collection[str] | None = None,
        begun: Tensor | None = None,
    ) -> None:
        check_groups(groups or (), environment)
        self._environment, self._folder, self._wanted, self._seed = environment, folder, wanted, seed
        self._layouts = {n: o for n, o in environment.observation.items() if groups is None or n in groups}
        self._states, self._memory = WorldStates(environment.world), TaskMemory(environment)
        self._frames = dict(tracked_frames(environment.world))
        sensors = environment.world.sensors.items()
        self._contacts = {name: sensor for name, sensor in sensors if isinstance(sensor, ContactSensor)}
        self._rings: dict[str, Tensor] = {}
        self._capacity = environment.max_episode_steps + 1
        self._step = 0
        self._initial = {name: value.clone() for name, value in self._memory.read().items()}
        self._seen = environment.observe()
        none = torch.zeros(environment.num_envs, dtype=torch.int64, device=environment.device)
        self.ended = none if begun is None else begun.clone()
        """(N,) episodes that each environment has ended."""
        self.kept = 0
        """Episodes that were written."""

    def before_step(self) -> None:
        """Take in the state, and what is seen of it."""
        self._put(STATES, self._states.read())
        for name, (entity, frame) in self._frames.items():
            self._put(POSES + name, entity.frame_pose(frame))
        for name, sensor in self._contacts.items():
            self._put(CONTACTS + name, sensor.forces)
        for name, value in self._leaves(self._seen):
            self._put(OBSERVED + name, value)

    def stepped(self, action: Tensor, result: StepResult) -> None:
        """Take in what was done and what it gave; write the episodes that ended."""
        self._seen, reward, terminated, truncated, info = result
        self._put(ACTIONS, action.clamp(-1.0, 1.0))
        self._put(REWARDS, reward)
        self._put(DONES, terminated | truncated)
        self._step += 1
        if "final" in info:
            self._finish(info["final"])

    def finish(self, end: EpisodeEnd) -> None:
        """Write episodes that are ended from outside, now, as if their last step had ended them."""
        self._rings[DONES][(self._step - 1) % self._capacity, end.env_ids] = True
        self._finish(end)

    def _put(self, name: str, value: Tensor) -> None:
        ring = self._rings.get(name)
        if ring is None:
            ring = self._rings[name] = value.new_zeros((self._capacity, *value.shape))
        if value.shape != ring.shape[1:]:
            raise ShapeError(f"'{name}' has shape {tuple(value.shape)}, but had {tuple(ring.shape[1:])} before")
        ring[self._step % self._capacity] = value

    def _leaves(self, observation: Observation) -> list[tuple[str, Tensor]]:
        """A tensor for each group that is one, and for each term of a dictionary, by ``group`` or ``group/term``."""
        leaves: list[tuple[str, Tensor]] = []
        for group in self._layouts:
            value = observation[group]
            named = {f"{group}/{term}": each for term, each in value.items()} if isinstance(value, dict) else {}
            leaves += named.items() if isinstance(value, dict) else [(group, value)]
        return leaves

    def _finish(self, end: EpisodeEnd) -> None:
        ids = end.env_ids
        rows = self._wanted(end, self.ended[ids]).nonzero().squeeze(-1)
        if len(rows):
            kept = end.only(rows)
            self._folder.add(self._infos(kept), self._arrays(kept))
            self.kept += len(rows)
        self.ended[ids] += 1
        for name, value in self._memory.read().items():
            self._initial[name][ids] = value[ids]

    def _infos(self, end: EpisodeEnd) -> list[EpisodeInfo]:
        count, backend = self._environment.num_envs, self._environment.world.backend
        returns = torch.stack(list(end.rewards.values())).sum(0).tolist() if end.rewards else [0.0] * len(end.env_ids)
        ids, numbers = end.env_ids.tolist(), self.ended[end.env_ids].tolist()
        metrics = {name: values.tolist() for name, values in end.metrics.items()}
        return [
            EpisodeInfo(
                number=number * count + env_id,
                length=length,
                success=success,
                episode_return=returns[row],
                metrics={name: float(values[row]) for name, values in metrics.items()},
                seed=self._seed,
                env_id=env_id,
                episode=number,
                backend=backend,
            )
            for row, (env_id, number, length, success) in enumerate(
                zip(ids, numbers, end.steps.tolist(), end.success.tolist(), strict=True)
            )
        ]

    def _arrays(self, end: EpisodeEnd) -> dict[str, Array]:
        """The steps of episodes that end now, one episode after the other, and how each began."""
        lengths, total = end.steps, int(end.steps.sum())
        last = lengths.cumsum(0) - 1
        first = (last - lengths + 1).repeat_interleave(lengths)
        begin = (self._step - lengths).repeat_interleave(lengths)
        steps = (begin + torch.arange(total, device=lengths.device) - first) % self._capacity
        columns = end.env_ids.repeat_interleave(lengths)
        flat = {name: ring[steps, columns] for name, ring in self._rings.items()}
        arrays = {name: value for name, value in flat.items() if not name.startswith(OBSERVED)}
        for name, final in self._leaves(end.observation):
            value = flat[OBSERVED + name]
            following = value.roll(-1, 0)
            following[last] = final
            self._add_terms(arrays, name, value, following)
        arrays |= {INITIAL + name: value[end.env_ids] for name, value in self._initial.items()}
        return {name: value.cpu().numpy() for name, value in arrays.items()}

    def _add_terms(self, arrays: dict[str, Tensor], name: str, value: Tensor, following: Tensor) -> None:
        """The terms of an observation by their names: those of group ``policy`` bare, others after their group's."""
        layout = self._layouts[name.partition("/")[0]]
        for term, columns in _terms_in(layout, name).items():
            arrays[OBSERVED + term] = value[:, columns]
            if value.dim() < 4:  # the next picture is the next row's
                arrays[NEXT + term] = following[:, columns]


def tracked_frames(world: World) -> Iterator[tuple[str, tuple[Object, str]]]:
    """Yield the frames whose poses describe a world: end effectors, and links of objects that can move.

    A robot without an end effector has the frame of its root.

    Args:
        world: whose robots and objects are listed.

    Yields:
        Name of the track, and the entity and frame that it follows.
    """
    for name, robot in world.robots.items():
        ends = [end.frame for end in robot.spec.end_effectors] if isinstance(robot, Robot) else []
        for frame in ends or robot.link_names[:1]:
            yield f"{name}/{frame}", (robot, frame)
    for name, thing in world.objects.items():
        for link in thing.link_names[1 if thing.spec.fixed_base else 0 :]:
            yield (name if len(thing.link_names) == 1 else f"{name}/{link}"), (thing, link)


def _terms_in(layout: GroupLayout, name: str) -> dict[str, slice]:
    """Columns of each term in a tensor of the group, by the term's name in files."""
    prefix = "" if layout.name == POLICY else f"{layout.name}/"
    if layout.concatenated:
        return {prefix + term: columns for term, columns in layout.columns.items()}
    return {prefix + name.partition("/")[2]: slice(None)}
