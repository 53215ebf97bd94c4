"""Measure estimators of the frame error from Python: `from rendezvous import evaluate`."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from pathlib import Path

import pandas as pd

from rendezvous.alignment.estimate import FrameErrorEstimator
from rendezvous.commands.evaluate.frame_error import Evaluation, measure_and_report
from rendezvous.methods import own_method


def evaluate(
    data: str | Path = "data",
    *,
    methods: Mapping[str, Callable[..., FrameErrorEstimator]] | None = None,
    beside: Iterable[str] = (),
    split: str = "test",
    count: int | None = None,
    xy_range_m: float = 2.0,
    yaw_range_deg: float = 45.0,
    seed: int = 0,
    report: str | Path = "report",
    workers: int = 1,
) -> pd.DataFrame:
    """Measure estimators of the frame error, yours beside the shipped ones, and write the report.

    ```python
    class MyEstimator:
        name = "mine"

        def __call__(self, window: MapWindow) -> Estimate:
            return Estimate(theta=SE2.identity())

    outcomes = rendezvous.evaluate("data", methods={"mine": MyEstimator}, beside=["correlative"])
    print(outcomes.groupby("method")[["position_m", "heading_rad", "success"]].mean())
    ```

    Args:
        data: folder of a dataset, or that of all stages, with the dataset in `dataset/`.
        methods: your classes or functions that return an estimator, by name. One with a parameter `search` is
            given the `SearchRange` from which frame errors are drawn. With more than one worker they must be
            importable from a module.
        beside: names of shipped or installed methods; none for all that need no weights or whose weights are
            found.
        split: train, validation or test.
        count: at most this many pairs, drawn at random; None for all.
        xy_range_m, yaw_range_deg: half widths of the frame errors' uniform distribution.
        seed: of the frame errors, window headings and draw of pairs.
        report: folder for index.html, metrics.json and perturbations.json.
        workers: processes; 1 means this one.

    Returns:
        One row for each pair under each method of this run. Columns: method, pair_id, overlap; x_m, y_m,
        yaw_rad of the error that is left, position_m, heading_rad; failed, flagged, success, wrong;
        covariance, degrees_of_freedom, log_density, meeting_m, duration_s (see `outcome_table`).

    Raises:
        PipelineError: the dataset or a method cannot be used; the message says what would be right.
    """
    named = [own_method(name, factory, number=n) for n, (name, factory) in enumerate((methods or {}).items())]
    folder = Path(data)
    return measure_and_report(
        Evaluation(
            dataset=str(folder / "dataset" if (folder / "dataset").is_dir() else folder),
            split=split,
            count=count,
            methods=tuple(beside),
            own={method.name: method for method in named},
            xy_range_m=xy_range_m,
            yaw_range_deg=yaw_range_deg,
            seed=seed,
            folder=Path(report),
            workers=workers,
        )
    )
