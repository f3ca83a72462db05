"""Peers that ORBIT is measured against: their packages, their environments, and ORBIT's counterpart of each."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True, kw_only=True)
class Counterpart:
    """Environment of ORBIT at the rates of a peer's environment."""

    task: str
    """Name of the task."""
    backend: str = "mujoco"
    """Name of the backend."""
    fields: Mapping[str, Any] = field(default_factory=dict)
    """Fields of the task: rates, robot and action space."""


@dataclass(frozen=True, kw_only=True)
class Case:
    """An environment of a peer, and ORBIT's next to it."""

    name: str
    """Name of the case on the command line and on the page."""
    environment: str
    """Name that the peer gives its environment."""
    robot: str
    """Robot of the peer's environment."""
    options: Mapping[str, Any] = field(default_factory=dict)
    """Arguments of the peer's adapter."""
    orbit: Counterpart
    """Environment of ORBIT that it is compared with."""
    differs: str
    """Differences other than those that the table of rates shows."""


@dataclass(frozen=True, kw_only=True)
class Peer:
    """A project with environments of robots."""

    name: str
    """Name on the command line, of its adapter, and of its folder."""
    title: str
    """Name of the project."""
    packages: tuple[str, ...] = ()
    """Requirements with versions, for pip; none for a peer that runs in ORBIT's own environment."""
    device: str = "cpu"
    """Device that it is measured on."""
    ways: tuple[str, ...] = ("batched",)
    """Ways of stepping several environments; the page takes the fastest."""
    num_envs: tuple[int, ...] = (1, 16)
    """Numbers of environments."""
    cases: tuple[Case, ...]
    """Environments that are compared."""


# ORBIT's release where the peer runs with it. Gymnasium-Robotics and robosuite compare joint types in a way that newer
# bindings answer otherwise, and Meta-World requires 3.3.0.
_MUJOCO, _OLDER_MUJOCO = "mujoco==3.17.0", "mujoco==3.3.7"
_GYMNASIUM = "gymnasium==1.4.0"
# Of Gymnasium's vector environments: a process for each environment, and one environment after the other.
_PROCESSES = ("processes", "in turn")
_GPU_SIZES = (1024, 4096)


def _rates(physics_dt: float, decimation: int, **fields: Any) -> dict[str, Any]:
    return {"physics_dt": physics_dt, "decimation": decimation, **fields}


_RAW = Peer(
    name="raw",
    title="raw MuJoCo",
    cases=(
        Case(
            name="Lift",
            environment="Lift",
            robot="franka_panda",
            orbit=Counterpart(task="Lift", fields=_rates(0.005, 4)),
            differs="the same model, states and commands; the peer makes no observation, reward or reset",
        ),
    ),
)

_DM_CONTROL = Peer(
    name="dm_control",
    title="dm_control",
    packages=("dm-control==1.0.50", _MUJOCO, _GYMNASIUM),
    ways=_PROCESSES,
    cases=(
        Case(
            name="humanoid",
            environment="humanoid-run",
            robot="humanoid of 21 joints",
            orbit=Counterpart(task="Humanoid", fields=_rates(0.005, 5)),
            differs="another model of a humanoid: 21 driven joints against 17",
        ),
        Case(
            name="quadruped",
            environment="quadruped-run",
            robot="quadruped of 12 actuators",
            orbit=Counterpart(task="Ant", fields=_rates(0.005, 4)),
            differs="legs of four joints with tendons against two; muscles' filters in the actuators",
        ),
        Case(
            name="lift",
            environment="manipulation/lift_large_box_features",
            robot="Kinova Jaco, three fingers",
            orbit=Counterpart(task="Lift", fields=_rates(0.002, 20, robot="jaco2", action="joint_velocity")),
            differs="a larger box; another model of the same arm",
        ),
    ),
)

_GYMNASIUM_ROBOTICS = Peer(
    name="gymnasium_robotics",
    title="Gymnasium-Robotics",
    packages=("gymnasium-robotics==1.4.2", _OLDER_MUJOCO, _GYMNASIUM),
    ways=_PROCESSES,
    cases=(
        Case(
            name="pick-and-place",
            environment="FetchPickAndPlace-v4",
            robot="Fetch",
            orbit=Counterpart(task="Lift", fields=_rates(0.002, 20, action="ik_relative")),
            differs="Fetch's hand hangs on a mocap body, so its arm needs no controller; ORBIT has no Fetch: Panda",
        ),
        Case(
            name="ant",
            environment="Ant-v5",
            robot="Ant",
            orbit=Counterpart(task="Ant", fields=_rates(0.01, 5)),
            differs="the same robot; RK4 against ORBIT's implicit integrator: four evaluations a step",
        ),
        Case(
            name="humanoid",
            environment="Humanoid-v5",
            robot="Humanoid",
            orbit=Counterpart(task="Humanoid", fields=_rates(0.003, 5, episode_length=15.0)),
            differs="the same robot; RK4 against ORBIT's implicit integrator: four evaluations a step",
        ),
    ),
)

_METAWORLD = Peer(
    name="metaworld",
    title="Meta-World",
    packages=("metaworld==3.1.1", "mujoco==3.3.0", _GYMNASIUM, "packaging==25.0"),
    ways=("processes",),
    cases=(
        Case(
            name="pick-place",
            environment="pick-place-v3",
            robot="Sawyer",
            orbit=Counterpart(task="Lift", fields=_rates(0.0025, 5, action="ik_relative")),
            differs="Sawyer's hand hangs on a mocap body; ORBIT has no Sawyer: Panda",
        ),
    ),
)

_ROBOSUITE = Peer(
    name="robosuite",
    title="robosuite",
    packages=("robosuite==1.5.2", _OLDER_MUJOCO, _GYMNASIUM, "h5py==3.15.1"),
    ways=("processes",),
    cases=(
        Case(
            name="lift",
            environment="Lift",
            robot="Panda",
            orbit=Counterpart(task="Lift", fields=_rates(0.002, 25, action="osc")),
            differs="operational-space control on both sides, computed at every physics step; robosuite has no vector "
            "environment: Gymnasium's around its own wrapper",
        ),
        Case(
            name="lift-ik",
            environment="Lift",
            robot="Panda",
            orbit=Counterpart(task="Lift", fields=_rates(0.002, 25, action="ik_relative")),
            differs="ORBIT's usual `ik_relative`, which the engine's drives track, against robosuite's "
            "operational-space control at every physics step",
        ),
    ),
)

_MANISKILL = Peer(
    name="maniskill",
    title="ManiSkill",
    packages=("mani-skill==3.0.1", "sapien==3.0.3", "torch==2.13.0"),
    ways=_PROCESSES,
    cases=(
        Case(
            name="pick-cube",
            environment="PickCube-v1",
            robot="Panda with a wrist camera's mount",
            orbit=Counterpart(task="Lift", backend="sapien", fields=_rates(0.01, 5, action="joint_position_relative")),
            differs="PhysX on a CPU on both sides; its own pd_joint_delta_pos",
        ),
        Case(
            name="pick-cube-mujoco",
            environment="PickCube-v1",
            robot="Panda with a wrist camera's mount",
            orbit=Counterpart(task="Lift", fields=_rates(0.01, 5, action="joint_position_relative")),
            differs="PhysX against MuJoCo, both on a CPU; its own pd_joint_delta_pos",
        ),
    ),
)

_MJLAB = Peer(
    name="mjlab",
    title="mjlab",
    packages=("mjlab==1.6.0", "torch==2.13.0"),
    device="cuda",
    num_envs=_GPU_SIZES,
    cases=(
        Case(
            name="velocity-flat-go1",
            environment="Mjlab-Velocity-Flat-Unitree-Go1",
            robot="Unitree Go1",
            orbit=Counterpart(task="Velocity-Flat", backend="warp", fields=_rates(0.005, 4, robot="unitree_go1")),
            differs="the same robot from other files; both by MuJoCo-Warp, of other versions",
        ),
        Case(
            name="velocity-flat-g1",
            environment="Mjlab-Velocity-Flat-Unitree-G1",
            robot="Unitree G1",
            orbit=Counterpart(task="Velocity-Flat", backend="warp", fields=_rates(0.005, 4, robot="unitree_g1")),
            differs="the same robot from other files; both by MuJoCo-Warp, of other versions",
        ),
        Case(
            name="lift",
            environment="Mjlab-Lift-Cube-Yam",
            robot="YAM arm",
            orbit=Counterpart(task="Lift", backend="warp", fields=_rates(0.005, 4)),
            differs="ORBIT has no YAM: Panda; both by MuJoCo-Warp, of other versions",
        ),
    ),
)

_PLAYGROUND = Peer(
    name="playground",
    title="MuJoCo Playground",
    packages=("playground==0.2.0", "jax[cuda13]==0.10.0"),
    device="cuda",
    num_envs=_GPU_SIZES,
    cases=(
        Case(
            name="humanoid",
            environment="HumanoidRun",
            robot="humanoid of 21 joints",
            orbit=Counterpart(task="Humanoid", backend="warp", fields=_rates(0.005, 5)),
            differs="another model of a humanoid: 21 driven joints against 17",
        ),
        Case(
            name="velocity-flat-go1",
            environment="Go1JoystickFlatTerrain",
            robot="Unitree Go1",
            orbit=Counterpart(task="Velocity-Flat", backend="warp", fields=_rates(0.004, 5, robot="unitree_go1")),
            differs="its model is downloaded at the first run",
        ),
    ),
)

_NEWTON = Peer(
    name="newton",
    title="Newton",
    packages=("newton[sim,importers]==1.8.0",),
    device="cuda",
    num_envs=_GPU_SIZES,
    cases=(
        Case(
            name="humanoid",
            environment="nv_humanoid.xml",
            robot="humanoid of 21 joints",
            options={"physics_dt": 0.005, "decimation": 4},
            orbit=Counterpart(task="Humanoid", backend="warp", fields=_rates(0.005, 4)),
            differs="physics only: Newton has no environments; another model of a humanoid; both by MuJoCo-Warp",
        ),
    ),
)

PEERS: dict[str, Peer] = {
    peer.name: peer
    for peer in (
        _RAW, _GYMNASIUM_ROBOTICS, _ROBOSUITE, _METAWORLD, _DM_CONTROL, _MANISKILL, _MJLAB, _PLAYGROUND, _NEWTON,
    )
}  # fmt: skip
"""Peers by name, in the order of the page."""
