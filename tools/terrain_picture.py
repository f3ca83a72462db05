"""Makes docs/images/terrain.png: kinds of terrain from left to right, levels from the back to the front.

python tools/terrain_picture.py
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from PIL import Image

from orbit_assets.catalogue import robot
from orbit_assets.terrain import Boxes, Gap, Pit, Rough, Slope, Stairs, SteppingStones, TerrainGrid, Waves
from orbit_core.scene import CameraSpec, Channel, Pose, Scene, look_at
from orbit_core.sensors import CameraSensor
from orbit_core.world import simulate

GRID = TerrainGrid(
    kinds=(
        Slope(platform=1.5), Stairs(platform=1.5), Stairs(platform=1.5, down=True), Rough(platform=1.5),
        Boxes(platform=1.5), SteppingStones(platform=1.5), Gap(platform=1.5), Pit(platform=1.5), Waves(platform=1.5),
    ),
    levels=3, cell_size=5.0, resolution=0.05, border=1.0, color=(0.75, 0.7, 0.6, 1.0),
)  # fmt: skip


def main() -> None:
    """Stand a robot on each cell and take the picture."""
    robots = []
    for level, row in enumerate(GRID.origins):
        for kind, (x, y, z) in enumerate(row):
            spec = robot("anymal_c" if (level + kind) % 2 else "unitree_go2", name=f"robot{level}{kind}")
            robots.append(replace(spec, pose=Pose((float(x), float(y), float(z) + spec.pose.position[2]))))
    view = look_at(eye=(27.0, 0.0, 15.5), target=(1.0, 0.0, -1.5))
    camera = CameraSpec(name="camera", width=1400, height=560, vertical_fov=0.58, pose=view, far=300.0)
    scene = Scene(terrain=GRID.shapes(), robots=tuple(robots), sensors=(camera,))
    world = simulate(scene, 1, "sapien")
    world.reset()
    sensor = world.sensors["camera"]
    assert isinstance(sensor, CameraSensor)
    picture = Image.fromarray(sensor.images[Channel.RGB][0].cpu().numpy())
    picture.save(Path(__file__).parents[1] / "docs" / "images" / "terrain.png")
    world.close()


if __name__ == "__main__":
    main()
