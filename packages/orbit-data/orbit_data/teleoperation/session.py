"""Session of a person who drives the robot by a device: recording of episodes, and pictures for the person."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from orbit_core.dynamics.transforms import pose_multiply
from orbit_core.envs.episode import EpisodeEnd
from orbit_core.scene import CameraSpec, Channel, Pose, look_at
from orbit_data.manifest.manifest import Manifest
from orbit_data.recording import DemonstrationRecorder, RecordingFile
from orbit_data.teleoperation.device import Device, DeviceLostError, Event, Reading
from orbit_data.teleoperation.driver import Driver
from orbit_data.teleoperation.intervention import Intervention

if TYPE_CHECKING:
    from orbit_core.envs.actors import Actor
    from orbit_core.envs.environment import Environment
    from orbit_core.interfaces import Renderer, World

Picture = npt.NDArray[np.uint8]
_HAND = CameraSpec(name="hand view", width=160, height=120, vertical_fov=1.2, far=5.0)
_SIDE = CameraSpec(name="side view", width=160, height=120, vertical_fov=0.8)
# Pose of the hand's camera in the end effector's frame, whose z points out of the hand.
_BESIDE_FINGERS = look_at(eye=(0.1, 0.0, -0.12), target=(0.045, 0.0, 0.03), up=(1.0, 0.0, 0.0))
# Offset in m of the side camera: before the robot, to its right. The page's own camera is to its left.
_FROM = (0.75, -0.85, 0.5)


class Views:
    """Pictures of one environment for a person, independent of the task's cameras.

    Args:
        world: world of the environment.
        driver: driver whose hand one camera follows, and the other looks at.
    """

    def __init__(self, world: World, driver: Driver) -> None:
        self._world, self._driver = world, driver
        self._renderer: Renderer | None = None  # made in the thread that draws
        hand = driver.hand
        self._middle = hand.measured[0, :3].clone() if hand else world.link_poses[0, :, :3].mean(0)
        self.pictures: dict[str, Callable[[], Picture]] = {"side": self._side}
        """Functions that draw pictures (H, W, 3), by name."""
        if hand:
            self.pictures = {"hand": self._hand, **self.pictures}

    def close(self) -> None:
        """Free the renderer."""
        if self._renderer is not None:
            self._renderer.close()

    def _hand(self) -> Picture:
        hand = self._driver.hand
        return self._drawn(_HAND, pose_multiply(hand.measured, self._tensor(_BESIDE_FINGERS))) if hand else self._side()

    def _side(self) -> Picture:
        x, y, z = self._middle.tolist()
        eye = (x + _FROM[0], y + _FROM[1], z + _FROM[2])
        return self._drawn(_SIDE, self._tensor(look_at(eye=eye, target=(x, y, z))))

    def _drawn(self, spec: CameraSpec, pose: Tensor) -> Picture:
        world = self._world
        # Renderers belong to the thread that makes them, and pictures are drawn in the simulation's.
        if self._renderer is None:
            self._renderer = world.create_renderer((_HAND, _SIDE))
        markers = world.marker_poses if world.markers else None
        image = self._renderer.render(spec, pose, world.link_poses, (Channel.RGB,), markers)
        assert image.rgb is not None  # it was asked for
        return image.rgb[0].cpu().numpy()

    def _tensor(self, pose: Pose) -> Tensor:
        return torch.tensor([(*pose.position, *pose.orientation)], device=self._world.device)


# Period in s of showing the session's state on the device.
_TOLD = 0.2
# Period in s of the search for targets out of reach, which takes as long as several steps.
_LOOKED = 1.0


class Session:
    """Environment that a device drives, for the viewer, whose episodes are recorded on request.

    Args:
        environment: a single environment.
        driver: driver of its robots.
        device: device that is read at every step.
        name: name of the device, for the manifest.
        file: recording that receives the episodes.
        task: name that the environment was made by.
        seed: seed of its random stream.
        instruction: what the episodes show, in words.
        make_policy: makes the actor of a policy that acts until the person moves the device; None without one.

    Raises:
        ConfigurationError: the file was recorded with another environment.
    """

    def __init__(
        self,
        environment: Environment,
        driver: Driver,
        device: Device,
        name: str,
        file: RecordingFile,
        task: str,
        seed: int,
        instruction: str = "",
        make_policy: Callable[[], Actor] | None = None,
    ) -> None:
        self.num_envs, self.step_dt, self.world = 1, environment.step_dt, environment.world
        """Number of environments (one), seconds of a step and world, as the viewer reads them of any environment."""
        self._environment, self._driver, self._device, self._file, self._seed = environment, driver, device, file, seed
        file.take_up(replace(Manifest.of(environment, task, seed), input_device=name))
        self._name, self._instruction = name, instruction
        self._intervention = None if make_policy is None else Intervention(environment, driver, make_policy)
        self._recorder: DemonstrationRecorder | None = None
        self._success = False
        self._moved: float | None = None
        self._lost: DeviceLostError | None = None
        infos = file.infos()
        if infos:  # the random stream continues, so that the next episode differs from the recorded ones
            environment.world.random.begin(torch.tensor([max(infos)], device=environment.device))
        self.kept = len(infos)
        """Number of episodes in the file."""
        self.message = ""
        """Outcome of the person's last request."""
        self.latencies: deque[float] = deque(maxlen=50)
        """Seconds from a person's last actions to the end of the steps that executed them."""
        self._stepped: deque[float] = deque(maxlen=50)
        self._told_at = -_TOLD
        self._looked_at, self._reach = 0.0, ""

    @property
    def recording(self) -> bool:
        """True while the episode is recorded."""
        return self._recorder is not None

    # What the viewer calls

    def reset(self) -> None:
        """Begin a new episode; a recorded one is discarded, and the new one recorded."""
        self._begin(self.recording)

    def act(self) -> Tensor:
        """Return the action (1, A) of the device's requests; if it disappears the robot holds still for a step.

        Raises:
            DeviceLostError: the device disappeared before the last step.
        """
        if self._lost:
            raise self._lost
        try:
            reading = self._device.read()
        except DeviceLostError as error:
            self._lost = error
            reading = Reading()
        for event in reading.events:
            self._handle(event)
        self._moved = reading.moved_at
        if self._recorder:
            self._recorder.before_step()
        return (self._intervention or self._driver).act(reading)

    def step(self, action: Tensor) -> tuple[Any, Tensor, Tensor, Tensor, Mapping[str, Any]]:
        """Take one step, and return observation, reward, terminated, truncated and info."""
        result = self._environment.step(action)
        now = time.perf_counter()
        self._stepped.append(now)
        if self._moved is not None:
            self.latencies.append(now - self._moved)
        final = result[4].get("final")
        if self._recorder:
            if final:
                final = replace(final, success=final.success | self._success)
            self._recorder.stepped(action, (*result[:4], {"final": final} if final else {}))
            if final:
                self.kept = len(self._file.infos())
        if final:
            self.message = self._told("its time was over" if bool(result[3].any()) else "the task ended it")
            self._recorder = None
            self._restart()
        # Once a second at most: the search would lower the rate of steps.
        if now - self._looked_at >= _LOOKED:
            self._looked_at, self._reach = now, self._driver.reach_problem()
        if now - self._told_at >= _TOLD:
            self._told_at = now
            self._device.tell(self.information())
        return result

    def information(self) -> dict[str, str]:
        """Return rows for the viewer's panel."""
        rows = {"device": self._name, "driving": self._driver.active, "recording": "no"}
        if self._intervention is not None:
            rows["led by"] = "you" if self._intervention.leads else "the policy"
        if self.recording:
            rows["recording"] = "yes, marked a success" if self._success else "yes"
        rows["episodes kept"] = str(self.kept)
        if len(self._stepped) > 1 and (span := self._stepped[-1] - self._stepped[0]) > 0.0:
            rows["rate"] = f"{(len(self._stepped) - 1) / span:.0f} Hz"
        if self.latencies:
            mean = sum(self.latencies) / len(self.latencies)
            rows["latency"] = f"{1e3 * mean:.0f} ms, at most {1e3 * max(self.latencies):.0f} ms"
        if self._reach:
            rows["out of reach"] = self._reach
        return rows | ({"last": self.message} if self.message else {})

    def close(self) -> int:
        """Discard an open episode, gather the kept ones, and return the number of episodes in the file."""
        self._recorder = None
        if self._file.parts.files:
            self.kept = self._file.gather()
        self._file.release()
        return self.kept

    # What the person asks for

    def _handle(self, event: Event) -> None:
        if event is Event.RECORD:
            self._begin(True)
            self.message = "recording"
        elif event is Event.RESET:
            self._begin(self.recording)
            self.message = "started over"
        elif event is Event.SUCCESS and self.recording:
            self._success = not self._success
            self.message = "marked a success" if self._success else "no longer marked a success"
        elif event in (Event.SAVE, Event.DISCARD, Event.SUCCESS) and not self.recording:
            self.message = f"'{event.value}' has no effect: no episode is being recorded"
        elif event is Event.SAVE:
            self._save()
        elif event is Event.DISCARD:
            self._begin(False)
            self.message = "discarded"

    def _begin(self, recording: bool) -> None:
        self._environment.reset()
        self._restart()
        self._success, self._recorder = False, None
        if recording:
            begun = self.world.random.episode.clone()
            taught = None if self._intervention is None else lambda: self._intervention.led  # pyright: ignore
            self._recorder = DemonstrationRecorder(
                self._environment, self._file.parts, _everything, self._seed,
                begun=begun, instruction=self._instruction, taught=taught,
            )  # fmt: skip

    def _restart(self) -> None:
        """Let an episode begin for whoever acts."""
        self._driver.restart()
        if self._intervention is not None:
            self._intervention.begin()

    def _save(self) -> None:
        environment, recorder = self._environment, self._recorder
        assert recorder is not None
        if int(environment.state.episode_step[0]) == 0:
            self.message = "the episode has no steps yet, so nothing was saved"
            return
        sums = environment.reward_sums.unbind()
        success = environment.task.success(environment)
        end = EpisodeEnd(
            env_ids=environment.all_ids,
            observation=environment.observe(),
            success=success | self._success,
            metrics=environment.metrics(),
            rewards=dict(zip(environment.reward_terms, sums, strict=True)),
            steps=environment.state.episode_step.clone(),
        )
        recorder.finish(end)
        self.kept = len(self._file.infos())
        self.message = self._told("saved")
        self._begin(False)

    def _told(self, why: str) -> str:
        return f"{why}: {self.kept} episodes are kept" if self.recording else why


def _everything(end: EpisodeEnd, ended: Tensor) -> Tensor:
    return torch.ones_like(ended, dtype=torch.bool)
