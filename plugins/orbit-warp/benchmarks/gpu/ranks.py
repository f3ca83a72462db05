"""One world and one process on each GPU: with the same seed all worlds agree, and each GPU's rate is its own.

torchrun --nproc-per-node 2 plugins/orbit-warp/benchmarks/gpu/ranks.py
"""

from __future__ import annotations

import os
import time

import torch
import torch.distributed as distributed

from orbit_core.envs import make

_ENVS, _STEPS = 4096, 200


def main() -> None:
    rank = int(os.environ["LOCAL_RANK"])
    cuda = torch.cuda.is_available()
    device = torch.device("cuda", rank) if cuda else torch.device("cpu")
    if cuda:
        torch.cuda.set_device(device)
    distributed.init_process_group("nccl" if cuda else "gloo")
    environment = make("Lift", num_envs=_ENVS if cuda else 4, backend="warp", device=device, action="ik_relative")
    environment.reset(seed=0)
    generator = torch.Generator().manual_seed(0)
    actions = (2 * torch.rand(8, environment.num_envs, environment.action_size, generator=generator) - 1).to(device)
    observation = environment.step(actions[0])[0]["policy"]
    least, most = observation.clone(), observation.clone()
    distributed.all_reduce(least, distributed.ReduceOp.MIN)
    distributed.all_reduce(most, distributed.ReduceOp.MAX)
    assert observation.device == device
    assert (most - least).abs().max() < 1e-4, "worlds with the same seed and actions differ after one step"
    for action in actions:  # recorded by then
        environment.step(action)
    if cuda:
        torch.cuda.synchronize(device)
    begun = time.perf_counter()
    for step in range(_STEPS):
        environment.step(actions[step % 8])
    if cuda:
        torch.cuda.synchronize(device)
    rate = torch.tensor([environment.num_envs * _STEPS / (time.perf_counter() - begun)], device=device)
    rates = [torch.zeros_like(rate) for _ in range(distributed.get_world_size())]
    distributed.all_gather(rates, rate)
    if rank == 0:
        each = ", ".join(f"{float(one):,.0f}" for one in rates)
        print(f"{len(rates)} worlds agree; environment steps/s of each: {each}; together {float(sum(rates)):,.0f}")
    environment.close()
    distributed.destroy_process_group()


if __name__ == "__main__":
    main()
