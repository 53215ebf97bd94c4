"""All evaluations that can run, one after the other, into one report."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from rich.console import Console

from rendezvous.commands.evaluate.frame_error import Evaluation, evaluate
from rendezvous.commands.evaluate.fusion import FusionEvaluation, evaluate_fusion
from rendezvous.commands.evaluate.measuring import EvaluationSettings
from rendezvous.commands.evaluate.relative_pose import PoseEvaluation, evaluate_pose
from rendezvous.errors import ConfigError, PipelineError
from rendezvous.stages.weights.pose_source import PoseSource


@dataclass(frozen=True, slots=True, kw_only=True)
class EveryEvaluation(EvaluationSettings):
    """All evaluations of one dataset."""

    # At most this many pairs, and as many images; None for all pairs and 1,000 images.
    count: int | None = None
    source: PoseSource | None = None  # makes the estimator of the relative pose, instead of weights


def evaluate_all(settings: EveryEvaluation) -> Path:
    """Run every evaluation that has data and weights; print what is left out, and why.

    Returns:
        The page.

    Raises:
        ConfigError: none of them can run.
    """
    common: dict[str, Any] = {f.name: getattr(settings, f.name) for f in fields(EvaluationSettings)}
    posed = {**common, "source": settings.source}
    evaluations: dict[str, Callable[[], Path]] = {
        "relative pose": lambda: evaluate_pose(PoseEvaluation(count=settings.count or 1000, **posed)),
        "frame error": lambda: evaluate(Evaluation(count=settings.count, **common)),
        "fusion": lambda: evaluate_fusion(FusionEvaluation(count=settings.count, **posed)),
    }
    pages = [page for name, run in evaluations.items() if (page := _page(name, run, settings.console))]
    if not pages:
        raise ConfigError("no evaluation could run; each says above what it lacks")
    return pages[-1]


def _page(name: str, run: Callable[[], Path], console: Console) -> Path | None:
    """The page, or None, with a message, if that evaluation cannot run."""
    try:
        return run()
    except PipelineError as error:
        reason = " ".join(str(error).split())
        console.print(f"left out: {name}: {reason}", highlight=False, markup=False, soft_wrap=True)
        return None
