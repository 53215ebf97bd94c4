"""Fuse the maps of two robots that met; make the data to train and measure that on.

Names below are imported when they are first used: `import rendezvous` loads neither NumPy nor PyTorch nor
MuJoCo.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rendezvous.alignment.estimate import Estimate as Estimate
    from rendezvous.alignment.estimate import FrameErrorEstimator as FrameErrorEstimator
    from rendezvous.alignment.estimate import Identity as Identity
    from rendezvous.alignment.window import MapWindow as MapWindow
    from rendezvous.baselines.correlative import CorrelativeSearch as CorrelativeSearch
    from rendezvous.baselines.hough import HoughSpectrum as HoughSpectrum
    from rendezvous.baselines.orb import OrbRansac as OrbRansac
    from rendezvous.commands.evaluate.from_python import evaluate as evaluate
    from rendezvous.commands.fuse.from_python import fuse as fuse
    from rendezvous.errors import PipelineError as PipelineError
    from rendezvous.fusion.system import FusionResult as FusionResult
    from rendezvous.geometry.camera import PinholeCamera as PinholeCamera
    from rendezvous.geometry.occupancy_grid import OccupancyGrid as OccupancyGrid
    from rendezvous.geometry.se2 import SE2 as SE2
    from rendezvous.interop.camera_info import CameraInfo as CameraInfo
    from rendezvous.interop.camera_info import read_camera_info as read_camera_info
    from rendezvous.interop.ros_map import read_ros_map as read_ros_map
    from rendezvous.interop.ros_map import write_ros_map as write_ros_map
    from rendezvous.models.matcher_estimator import MatcherEstimator as MatcherEstimator
    from rendezvous.models.relative_pose_estimator import RelativePoseEstimator as RelativePoseEstimator
    from rendezvous.training.frame_error.pairs import MapPair as MapPair
    from rendezvous.training.frame_error.pairs import read_pairs as read_pairs

    __version__: str

_HOME = {
    "CameraInfo": "interop.camera_info",
    "CorrelativeSearch": "baselines.correlative",
    "Estimate": "alignment.estimate",
    "FrameErrorEstimator": "alignment.estimate",
    "FusionResult": "fusion.system",
    "HoughSpectrum": "baselines.hough",
    "Identity": "alignment.estimate",
    "MapPair": "training.frame_error.pairs",
    "MapWindow": "alignment.window",
    "MatcherEstimator": "models.matcher_estimator",
    "OccupancyGrid": "geometry.occupancy_grid",
    "OrbRansac": "baselines.orb",
    "PinholeCamera": "geometry.camera",
    "PipelineError": "errors",
    "RelativePoseEstimator": "models.relative_pose_estimator",
    "SE2": "geometry.se2",
    "evaluate": "commands.evaluate.from_python",
    "fuse": "commands.fuse.from_python",
    "read_camera_info": "interop.camera_info",
    "read_pairs": "training.frame_error.pairs",
    "read_ros_map": "interop.ros_map",
    "write_ros_map": "interop.ros_map",
}
"""The module that defines each public name."""

__all__ = ["__version__", *_HOME]


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from importlib.metadata import version

        return version("rendezvous-fusion")
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOME[name]}"), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
