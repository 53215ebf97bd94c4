"""Evaluations of a toy dataset, and weights of tiny networks to evaluate."""

from __future__ import annotations

import io
import json
from dataclasses import asdict
from pathlib import Path

import pytest
from rich.console import Console

from rendezvous.commands.evaluate.frame_error import Evaluation, evaluate
from rendezvous.stages.pack import pack
from tests.synthetic_dataset import explored, synthetic_run

TINY_VIT = {"cells": 48, "width": 32, "depth": 1, "heads": 2}
TINY_MATCHER = {"channels": 8, "dilations": [1, 2]}


def toy_dataset(folder: Path) -> Path:
    """The folder of all stages, up to `pack`."""
    explored(folder)
    pack(synthetic_run(folder))
    return folder


def evaluated(data: Path, folder: Path, *methods: str, **settings) -> tuple[dict, str]:
    """What `metrics.json` holds, and what was told."""
    told = io.StringIO()
    evaluate(
        Evaluation(
            dataset=f"{data}/dataset",
            methods=methods,
            folder=folder,
            records=settings.pop("records", folder / "records"),
            console=Console(file=told),
            **settings,
        )
    )
    return json.loads((folder / "metrics.json").read_text())["frame_error"], told.getvalue()


def mean_error(metrics: dict, method: str) -> list[float]:
    return [m["value"] for m in metrics["methods"][method]["summary"]["overall"]["mean"]]


def trained_weights(
    folder: Path, name: str, settings: dict, *, trained_on: tuple[str, ...] = (), **sampling
) -> Path:
    """Weights of a tiny network, and its curve beside them."""
    torch = pytest.importorskip("torch")
    from rendezvous.training.checkpoint import weights_bytes
    from rendezvous.training.frame_error.registry import build_model
    from rendezvous.training.loop import TrainingState
    from rendezvous.training.parameters import Optimisation, Sampling

    torch.set_num_threads(1)
    model = build_model(name, settings, Sampling(**sampling), seed=0)
    data = {"folder": "somewhere", "pairs": {"train": 7}, "plans": {"train": 2}}
    about = {
        "model": name,
        "network": model.config(),
        "sampling": asdict(Sampling(**sampling)),
        "seed": 3,
        "data": {**data, "plan_digests": list(trained_on)},
    }
    state = TrainingState.fresh(model, Optimisation())
    state.samples = 16
    folder.mkdir(exist_ok=True)
    (folder / "weights.safetensors").write_bytes(weights_bytes(state, about))
    point = {"samples": 16, "elapsed_s": 30.0, "error_x_m": 1.0, "error_y_m": 1.0, "error_yaw_rad": 0.4}
    (folder / "curve.json").write_text(json.dumps({**about, "samples": 16, "curve": [point]}))
    return folder / "weights.safetensors"
