"""Robot files: `assets/robots/<name>/robot.yaml`, or one's own."""

from __future__ import annotations

import json
from pathlib import Path

from pydantic import ValidationError

from pipeline.config import Section
from pipeline.config_errors import explained
from pipeline.errors import ConfigError, PipelineError
from pipeline.simulation.robot import RobotSpec
from pipeline.strict_yaml import load_file

ROBOTS = Path(__file__).parents[1] / "assets" / "robots"


class _RobotFile(Section):
    robot: RobotSpec


def load_robot(robot: str) -> RobotSpec:
    """Read a robot.

    Args:
        robot: the name of one in `assets/robots`, or the path of a robot file.

    Raises:
        ConfigError: there is none, or it has an unknown key or a wrong value.
    """
    path = Path(robot) if robot.endswith((".yaml", ".yml")) else ROBOTS / robot / "robot.yaml"
    if not path.is_file():
        known = ", ".join(sorted(p.name for p in ROBOTS.iterdir() if (p / "robot.yaml").is_file()))
        raise ConfigError(f"robot {robot!r}: no file {path}; known robots are {known}, or give a .yaml file")
    values = {"robot": load_file(path)}
    try:
        return _RobotFile.model_validate_json(json.dumps(values)).robot
    except ValidationError as error:
        raise ConfigError(explained(error, _RobotFile, file=str(path), layers={})) from error
    except PipelineError as error:
        raise ConfigError(f"{path}: {error}") from error
