"""Make a small dataset of a robot of your own: a robot file, a model made of boxes, then all stages.

Writes `courier.yaml`, `courier.glb` and the folder `data-courier`.
"""

import subprocess
import sys
from pathlib import Path

import yaml

from rendezvous.rendering.robot_model import SolidParts, robot_glb
from rendezvous.rendering.scene import Material
from rendezvous.resources import ROBOTS

LENGTH_M, WIDTH_M, HEIGHT_M = 0.24, 0.22, 0.26

# The robot file: a copy of the Burger's with other dimensions. The robot's frame: on the floor between the
# wheels, x forward, y left, z up.
robot = yaml.safe_load((ROBOTS / "burger" / "robot.yaml").read_text())
robot |= {"name": "courier", "size_m": [LENGTH_M, WIDTH_M, HEIGHT_M], "radius_m": 0.165, "mass_kg": 2.5}
robot["chassis"] |= {"radius_m": 0.1, "centre_x_m": -0.02, "top_z_m": 0.2}  # rests on wheels and caster
robot["wheels"]["track_m"] = 0.2
robot["lidar"] |= {"x_m": 0.0, "z_m": 0.24}
robot["camera"]["xyz_m"] = [0.11, 0.0, 0.15]
robot["cuboid"] = {"size_m": [LENGTH_M, WIDTH_M, HEIGHT_M], "centre_m": [0.0, 0.0, HEIGHT_M / 2]}
Path("courier.yaml").write_text(yaml.safe_dump(robot))

# What it looks like: a red body, a dark lidar, two wheels, and a white front that shows its heading.
looks = SolidParts(
    {
        "body": Material(base_colour_rgb=(0.6, 0.08, 0.06), roughness=0.5),
        "front": Material(base_colour_rgb=(0.9, 0.9, 0.9), roughness=0.4),
        "lidar": Material(base_colour_rgb=(0.05, 0.05, 0.06), roughness=0.3),
        "wheels": Material(base_colour_rgb=(0.1, 0.1, 0.1), roughness=0.9),
    }
)
looks.box("body", (0.23, 0.18, 0.19), (-0.005, 0.0, 0.115))
looks.box("front", (0.01, 0.16, 0.1), (0.115, 0.0, 0.13))
looks.box("lidar", (0.08, 0.08, 0.05), (0.0, 0.0, 0.235))
for side in (-1, 1):
    looks.box("wheels", (0.066, 0.018, 0.066), (0.0, side * 0.1, 0.033))
Path("courier.glb").write_bytes(robot_glb(looks.parts()))

robots = [f"--set={stage}.robot=courier.yaml" for stage in ("floorplans", "meshes", "explore")]
command = [sys.executable, "-m", "rendezvous.cli", "dataset", "--preset", "smoke", "--data", "data-courier"]
subprocess.run([*command, *robots, *sys.argv[1:]], check=True)
