"""What the pose network sees in an image: the robot's pose, how sure it is, and a picture; no maps needed."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rendezvous.commands.fuse.inputs import mounting, read_camera, read_photograph
from rendezvous.errors import StoreError
from rendezvous.evaluation.pictures.canvas import encoded_png
from rendezvous.evaluation.pictures.fusion import sighting_picture
from rendezvous.fusion.verdict import spread_of
from rendezvous.geometry.camera import se3_from_se2
from rendezvous.geometry.se2 import Array
from rendezvous.pose_estimation.pose_estimate import PoseMode, RelativePose
from rendezvous.robot_file import load_robot
from rendezvous.simulation.robot import RobotSpec
from rendezvous.stages.weights.pose_source import PoseWeights, require_known_robot
from rendezvous.store.disk import Disk


@dataclass(frozen=True, slots=True, kw_only=True)
class Seen:
    """What was seen in one image; `T_r0_c` (4, 4) is where its camera is on the robot that carries it."""

    name: str
    pose: RelativePose
    robot: RobotSpec
    T_r0_c: Array
    picture: bytes  # PNG: the image, undistorted, with the robot's cuboid over it

    def lines(self) -> list[str]:
        """The reading for people, a line for each thing that a tape measure and a protractor can check."""
        if not self.pose.found:
            return [f"{self.name}: no robot found ({self.pose.reason})"]
        lines = [f"{self.name}: robot found, score {self.pose.score:.2f}"]
        for mode in self.pose.modes:
            lines += self._mode_lines(mode)
        return lines

    def _mode_lines(self, mode: PoseMode) -> list[str]:
        T = mode.T_r0_r1
        position_m, heading_rad = spread_of(mode.covariance)
        lens = (se3_from_se2(T.inverse()) @ self.T_r0_c)[:3, 3] - self.robot.cuboid.centre_m
        bearing_deg = math.degrees(math.atan2(lens[1], lens[0]))
        return [
            f"  {mode.mass:.0%}: x {T.x_m:.3f} m, y {T.y_m:.3f} m, yaw {math.degrees(T.yaw_rad):.1f}° "
            f"(±{position_m:.3f} m, ±{math.degrees(heading_rad):.1f}°)",
            f"    lens to middle of the robot, along the floor: {math.hypot(*lens[:2]):.3f} m; the lens "
            f"is {abs(bearing_deg):.0f}° to the {'left' if bearing_deg > 0.0 else 'right'} of its front",
        ]

    def record(self) -> dict[str, Any]:
        """The reading as JSON."""
        modes = [
            {
                "T_r0_r1": dict(
                    zip(("x_m", "y_m", "yaw_rad"), mode.T_r0_r1.as_array().tolist(), strict=True)
                ),
                "covariance": mode.covariance.tolist(),
                "mass": mode.mass,
            }
            for mode in self.pose.modes
        ]
        return {
            "image": self.name,
            "found": self.pose.found,
            "score": self.pose.score,
            "reason": self.pose.reason,
            "modes": modes,
        }


def see(
    images: Sequence[Path],
    camera: Path,
    *,
    camera_pose: tuple[float, ...] | None = None,
    robot: str = "burger",
) -> list[Seen]:
    """Estimate the robot's pose in each image.

    Args:
        images: files that OpenCV reads, all taken by this camera.
        camera: a ROS camera_info file.
        camera_pose: x, y, z [m], roll, pitch, yaw [rad] of the camera's body, x forward, on the robot that
            carries it; as in the robot file by default.
        robot: a shipped robot or a robot file: the robot that is seen.

    Raises:
        CameraError, ConfigError, StoreError: an input cannot be read or used.
        SetupError: PyTorch is needed but not installed.
    """
    info, spec, T_r0_c = read_camera(camera), load_robot(robot), mounting(camera_pose, robot)
    shots = [read_photograph(path, info, number=number) for number, path in enumerate(images)]
    weights = PoseWeights.found(None)
    require_known_robot(
        weights.record(),
        spec.cuboid.size_m,
        spec.cuboid.T_r_o(),
        weights=str(weights.path),
        whose=repr(robot),
        instead="train a network on images of it (`rendezvous train-pose`)",
    )
    estimator = weights.estimator(floor=True)
    seen = []
    for shot in shots:
        pose = estimator(shot.image, info.camera, T_r0_c)
        picture = encoded_png(sighting_picture(shot.image, info.camera, pose, spec.cuboid.size_m))
        seen.append(Seen(name=shot.name, pose=pose, robot=spec, T_r0_c=T_r0_c, picture=picture))
    return seen


def write_seen(seen: Sequence[Seen], out: Path) -> list[Path]:
    """Write each picture, named like its image, and `seen.json` to a folder; returns their paths.

    Raises:
        StoreError: two images share a name, or the folder cannot be written.
    """
    names = [f"{Path(one.name).stem}.png" for one in seen]
    if repeated := sorted({name for name in names if names.count(name) > 1}):
        raise StoreError(f"{out}: two images would be written to {repeated[0]}; see them one after the other")
    files = {name: one.picture for name, one in zip(names, seen, strict=True)}
    files["seen.json"] = (json.dumps([one.record() for one in seen], indent=2) + "\n").encode()
    for name, content in files.items():
        Disk(str(out)).write(name, content)
    return [out / name for name in files]
