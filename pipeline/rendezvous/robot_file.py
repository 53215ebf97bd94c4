"""Robot files: `assets/robots/NAME/robot.yaml`, or the user's own; lidars of `assets/lidars` likewise."""

from __future__ import annotations

from pathlib import Path

from rendezvous.config.strict import Section, load_file, validated_section
from rendezvous.errors import ConfigError
from rendezvous.resources import LIDARS, ROBOTS, exists
from rendezvous.simulation.robot import Lidar, RobotSpec

_RIGHT = "a robot file, a YAML mapping such as assets/robots/burger/robot.yaml"


_RIGHT_LIDAR = "a lidar file, a YAML mapping such as assets/lidars/sick-lms.yaml"


class _RobotFile(Section):
    robot: RobotSpec


class _LidarFile(Section):
    lidar: Lidar


def load_robot(robot: str) -> RobotSpec:
    """Read a robot.

    Args:
        robot: the name of one in `assets/robots`, or the path of a robot file.

    Raises:
        ConfigError: there is no such file, or it has an unknown key or a wrong value.
    """
    path = _robot_file(robot)
    if not (exists(path) and path.is_file()):
        known = ", ".join(sorted(p.name for p in ROBOTS.iterdir() if (p / "robot.yaml").is_file()))
        raise ConfigError(
            f"robot {robot!r:.200}: no file {path!s:.200}; known robots are {known}, or give a .yaml file"
        )
    return validated_section(_RobotFile, {"robot": load_file(path, right=_RIGHT)}, file=str(path)).robot


def load_lidar(lidar: str) -> Lidar:
    """Read a lidar.

    Args:
        lidar: the name of one in `assets/lidars`, or the path of a lidar file.

    Raises:
        ConfigError: there is no such file, or it has an unknown key or a wrong value.
    """
    path = Path(lidar) if lidar.endswith((".yaml", ".yml")) else LIDARS / f"{lidar}.yaml"
    if not (exists(path) and path.is_file()):
        known = ", ".join(sorted(p.stem for p in LIDARS.glob("*.yaml")))
        raise ConfigError(
            f"lidar {lidar!r:.200}: no file {path!s:.200}; known lidars are {known}, or give a .yaml file"
        )
    return validated_section(_LidarFile, {"lidar": load_file(path, right=_RIGHT_LIDAR)}, file=str(path)).lidar


def load_robot_model(robot: str) -> bytes:
    """Read the binary glTF model beside a robot file.

    Raises:
        ConfigError: there is none.
    """
    path = _robot_file(robot).with_suffix(".glb")
    try:
        return path.read_bytes()
    except OSError as error:
        raise ConfigError(
            f"robot {robot!r}: no model {path} ({(error.strerror or str(error)).lower()}); pictures need one "
            "beside the robot file: binary glTF, in metres, on the floor between the wheels, x forward, z up"
        ) from error


def _robot_file(robot: str) -> Path:
    return Path(robot) if robot.endswith((".yaml", ".yml")) else ROBOTS / robot / "robot.yaml"
