"""On a GPU a step is one graph: it does what its operations do, and nothing in it waits for the device."""

from __future__ import annotations

import gc
import warnings

import pytest
import torch

from orbit_core.envs import make
from orbit_core.envs.environment import Environment
from orbit_core.envs.episode import StepInfo
from orbit_motion.fusion import Fused

TASKS = ["Lift", "Reach", "Cabinet", "Velocity-Flat", "Handover"]
LAWS = ["rmpflow", "osc", "impedance", "hybrid", "joint_impedance"]
WARM = 6
"""Steps: as it is, traced, run, recorded, and two replays."""

pytestmark = pytest.mark.skipif(not torch.cuda.is_available(), reason="needs the capability of a GPU")


def environment_of(task: str, compile: bool = False, **fields: str) -> Environment:
    settings = {"deterministic": True}
    return make(
        task, 64, "warp", device="cuda", seed=3, episode_length=0.4, settings=settings, compile=compile, **fields
    )


def actions_of(environment: Environment, steps: int) -> list[torch.Tensor]:
    generator = torch.Generator().manual_seed(0)
    shape = (steps, environment.num_envs, environment.action_size)
    return list((2.0 * torch.rand(shape, generator=generator) - 1.0).cuda())


@pytest.mark.parametrize("task", TASKS)
def test_a_recorded_step_is_the_same_step(task: str) -> None:
    plain, other = environment_of(task), environment_of(task)
    plain._closed = None
    for environment in (plain, other):
        environment.reset(seed=3)
        environment.state.episode_step[:] = torch.arange(64, device="cuda") % 7
    ends = 0
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # that the step could not be recorded is one
        for action in actions_of(plain, 45):
            mine, its = plain.step(action), other.step(action)
            torch.testing.assert_close(its[0]["policy"], mine[0]["policy"], rtol=1e-4, atol=1e-4)
            torch.testing.assert_close(its[1], mine[1], rtol=1e-4, atol=1e-4)
            assert torch.equal(its[2], mine[2])
            assert torch.equal(its[3], mine[3])
            assert ("final" in its[4]) == ("final" in mine[4])
            if "final" in mine[4]:
                ends += len(mine[4]["final"].env_ids)
                assert torch.equal(its[4]["final"].env_ids, mine[4]["final"].env_ids)
                assert torch.equal(its[4]["final"].steps, mine[4]["final"].steps)
    assert ends >= 64
    plain.close(), other.close()


@pytest.mark.parametrize("compile", [False, True])
@pytest.mark.parametrize("task", TASKS)
def test_nothing_in_a_step_waits(task: str, compile: bool) -> None:
    if compile:
        pytest.importorskip("triton")
    environment = environment_of(task, compile)
    actions = actions_of(environment, WARM + 30)
    for action in actions[:WARM]:
        environment.step(action)
    torch.cuda.set_sync_debug_mode("error")
    try:
        infos = [environment.step(action)[4] for action in actions[WARM:]]
    finally:
        torch.cuda.set_sync_debug_mode("default")
    assert all(isinstance(info, StepInfo) for info in infos)
    assert sum(len(info["final"].env_ids) for info in infos if "final" in info) >= 64
    environment.close()


@pytest.mark.parametrize("law", LAWS)
def test_laws_are_kernels_that_give_what_operations_give(law: str) -> None:
    pytest.importorskip("triton")
    plain, fused = (environment_of("Lift", compile, action=law) for compile in (False, True))
    for action in actions_of(plain, WARM + 6):
        mine, its = (environment.step(0.2 * action)[0]["policy"] for environment in (plain, fused))
        torch.testing.assert_close(its, mine, rtol=2e-3, atol=2e-3)
    kernels = [part for node in fused.actions.generators for part in vars(node).values() if isinstance(part, Fused)]
    assert kernels
    for part in kernels:
        assert part.operations, part.refusal
    plain.close(), fused.close()


def test_what_cannot_be_recorded_is_run_each_time() -> None:
    environment = environment_of("Lift")
    engine = environment.world.engine
    environment.reset(seed=3)
    seen: list[float] = []

    def operations() -> None:
        engine.step(2)
        seen.append(engine.joint_positions.sum().item())  # waits, which no recording can

    repeated = engine.capture.record(operations)
    repeated()
    with pytest.warns(RuntimeWarning, match="not recorded as one graph"):
        repeated()
    before = len(seen)
    gc.collect()
    repeated()
    assert len(seen) == before + 1
    environment.step(torch.zeros(64, environment.action_size, device="cuda"))
    environment.close()
