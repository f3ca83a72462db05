"""Collecting and learning of a peer in the steady state, by the trainer that the project comes with.

    PEER/bin/python benchmarks/peers/learn.py mjlab Mjlab-Velocity-Flat-Unitree-Go1 --num-envs 4096 --json learn.json

Run by the interpreter of the peer's virtual environment: standard library only, besides the project. Counted and timed
as in ``benchmarks/learning/speed.py``, which measures ORBIT: some iterations first, then medians over the next ones.
"""

from __future__ import annotations

import argparse
import functools
import itertools
import json
import os
import statistics
import time
from collections.abc import Sequence
from importlib import metadata
from pathlib import Path
from typing import Any


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("peer", choices=("mjlab", "playground"))
    parser.add_argument("environment", help="name that the project gives it")
    parser.add_argument("--num-envs", type=int, default=4096)
    parser.add_argument("--device", default="cuda")
    parser.add_argument("--warm", type=int, default=15, help="iterations before the timed ones")
    parser.add_argument("--timed", type=int, default=20, help="iterations that are timed")
    parser.add_argument("--json", type=Path, help="figures are added here")
    arguments = parser.parse_args()
    begun = time.perf_counter()
    figures = {"mjlab": by_rsl_rl, "playground": by_brax}[arguments.peer](arguments)
    whole = {
        "peer": arguments.peer, "environment": arguments.environment, "num_envs": arguments.num_envs,
        **figures, "whole_s": round(time.perf_counter() - begun, 1),
    }  # fmt: skip
    print(json.dumps(whole), flush=True)
    if arguments.json:
        with arguments.json.open("a") as file:
            file.write(json.dumps(whole) + "\n")


def by_rsl_rl(arguments: argparse.Namespace) -> dict[str, Any]:
    """Learn by mjlab's own configuration of RSL-RL."""
    from dataclasses import asdict

    import mjlab.tasks
    import torch
    from mjlab.envs import ManagerBasedRlEnv
    from mjlab.rl import MjlabOnPolicyRunner, RslRlVecEnvWrapper
    from mjlab.tasks.registry import load_env_cfg, load_rl_cfg, load_runner_cls
    from mjlab.utils.torch import configure_torch_backends

    assert mjlab.tasks  # its import registers the tasks
    configure_torch_backends()
    configuration, learner = load_env_cfg(arguments.environment), load_rl_cfg(arguments.environment)
    configuration.scene.num_envs, configuration.seed = arguments.num_envs, 0
    own = ManagerBasedRlEnv(cfg=configuration, device=arguments.device)
    environment = RslRlVecEnvWrapper(own, clip_actions=learner.clip_actions)
    kind = load_runner_cls(arguments.environment) or MjlabOnPolicyRunner
    runner = kind(environment, asdict(learner), None, arguments.device)
    ends, parts = [time.perf_counter()], []

    def logged(*_: Any, **words: Any) -> None:
        ends.append(time.perf_counter())
        parts.append((words["collect_time"], words["learn_time"]))

    runner.logger.log = logged  # without a folder it keeps nothing
    runner.learn(arguments.warm + arguments.timed, init_at_random_ep_len=True)
    seconds = [after - before for before, after in itertools.pairwise(ends)]
    timed, steps = seconds[arguments.warm :], arguments.num_envs * learner.num_steps_per_env
    collect, update = zip(*parts[arguments.warm :], strict=True)
    own.close()
    return {
        "library": f"rsl-rl {metadata.version('rsl-rl-lib')}",
        "env_steps_per_s": round(steps / statistics.median(timed)),
        "quartiles": [round(steps / value) for value in reversed(statistics.quantiles(timed, n=4)[::2])],
        "iteration_ms": round(1e3 * statistics.median(timed), 2),
        "collect_ms": round(1e3 * statistics.median(collect), 2),
        "update_ms": round(1e3 * statistics.median(update), 2),
        "steps_per_iteration": learner.num_steps_per_env,
        "first_iterations_s": [round(value, 2) for value in seconds[:6]],
        "device": torch.cuda.get_device_name(),
    }


def by_brax(arguments: argparse.Namespace) -> dict[str, Any]:
    """Learn by MuJoCo Playground's own configuration of Brax's PPO, whose iterations report no parts."""
    os.environ.setdefault("XLA_PYTHON_CLIENT_PREALLOCATE", "false")
    os.environ["XLA_FLAGS"] = os.environ.get("XLA_FLAGS", "") + " --xla_gpu_triton_gemm_any=True"  # as its own script
    import jax
    from brax.training.agents.ppo import networks, train
    from mujoco_playground import registry, wrapper
    from mujoco_playground.config import dm_control_suite_params, locomotion_params

    if not hasattr(jax, "device_put_replicated"):  # JAX 0.11 has none, and Brax 0.14.2 calls it
        jax.device_put_replicated = replicated
    locomotion = arguments.environment in registry.locomotion.ALL_ENVS
    of = locomotion_params if locomotion else dm_control_suite_params
    chosen = dict(of.brax_ppo_config(arguments.environment))
    # The batch of an iteration, in environment steps.
    batch = chosen["batch_size"] * chosen["num_minibatches"] * chosen["unroll_length"] * chosen["action_repeat"]
    each = max(1, arguments.timed // 2)
    network = functools.partial(networks.make_ppo_networks, **chosen.pop("network_factory", {}))
    chosen |= {
        "num_envs": arguments.num_envs, "num_timesteps": 3 * each * batch, "num_evals": 4, "num_resets_per_eval": 0,
    }  # fmt: skip
    rates: list[float] = []

    def progress(_: int, metrics: dict[str, Any]) -> None:
        if "training/sps" in metrics:
            rates.append(float(metrics["training/sps"]))

    train.train(
        environment=registry.load(arguments.environment), wrap_env_fn=wrapper.wrap_for_brax_training, seed=0,
        network_factory=network, progress_fn=progress, run_evals=False, **chosen,
    )  # fmt: skip
    # The first report includes compiling.
    return {
        "library": f"brax {metadata.version('brax')}",
        "env_steps_per_s": round(statistics.median(rates[1:])),
        "quartiles": [round(min(rates[1:])), round(max(rates[1:]))],
        "reports": [round(rate) for rate in rates],
        "steps_per_iteration": batch // arguments.num_envs,
        "device": jax.devices()[0].device_kind,
    }


def replicated(value: Any, devices: Sequence[Any]) -> Any:
    """Return a tree of arrays with a copy of each on each device, along a new first axis.

    Args:
        value: tree of arrays, each of any shape.
        devices: of JAX; the new axis is as long.
    """
    import jax
    import numpy as np

    # Brax's own name of the axis: under another, its second epoch is compiled anew within the timed part.
    mesh = jax.sharding.Mesh(np.array(devices), ("i",))
    spread = jax.sharding.NamedSharding(mesh, jax.sharding.PartitionSpec("i"))
    return jax.tree.map(lambda leaf: jax.device_put(jax.numpy.stack([leaf] * len(devices)), spread), value)


if __name__ == "__main__":
    main()
