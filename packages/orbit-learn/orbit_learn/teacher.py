"""Teachers: the task's expert, or a policy, labels the states that a student reaches."""

from __future__ import annotations

from collections.abc import Callable

from torch import Tensor

from orbit_core.envs.actors import Teacher
from orbit_core.envs.environment import Environment, Observation
from orbit_core.interfaces import ConfigurationError
from orbit_learn.across import AcrossEngines
from orbit_learn.memory import Remembering
from orbit_learn.policy import load_policy
from orbit_learn.pretrained import policy_path

EXPERT = "expert"
"""Name of the teacher that is the task's own expert."""


def teacher_of(environment: Environment | AcrossEngines, name: str) -> Callable[[Observation], Tensor]:
    """Return a function from observations to the actions (N, A) of the task's expert, or of a policy by name.

    Args:
        environment: that is taught in; each of several engines has a teacher of its own.
        name: of a kept policy, a policy's file, a training's folder, or :data:`EXPERT`.

    Raises:
        ConfigurationError: the policy does not fit, or the expert cannot teach where episodes begin on its way.
    """
    if isinstance(environment, AcrossEngines):
        return environment.each([teacher_of(part, name) for part in environment.parts])
    if name == EXPERT:
        if environment.starts is not None:
            # The expert's phases are not part of a recorded start.
            raise ConfigurationError(
                "an expert begins each episode with its first phase, also one that begins on its way: to let it teach, "
                "set expert_starts=0"
            )
        expert = environment.expert()
        # A teacher's phases follow from the state, which the student may have led elsewhere.
        if isinstance(expert, Teacher):
            expert.teaches = True
        return lambda seen: expert.compute({})["action"]
    teacher = load_policy(policy_path(name), environment.device)
    group = teacher.description.find_group(environment)
    acting = Remembering(teacher.module, environment.num_envs, environment.device)
    return lambda seen: acting.act(seen[group], environment.state.episode_step == 0)
