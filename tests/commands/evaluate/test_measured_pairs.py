from __future__ import annotations

import shutil
from importlib import metadata
from pathlib import Path

import pytest

pytest.importorskip("matplotlib")
pytest.importorskip("torch")

from rendezvous.stages import measured_pairs, measuring
from rendezvous.stages.weights.estimators import Method, chosen_methods
from rendezvous.training.frame_error.pairs import read_pairs
from rendezvous.training.frame_error.perturbation import PerturbationRange

from tests.commands.evaluate.toy_evaluation import TINY_VIT, toy_dataset, trained_weights
from tests.synthetic_dataset import synthetic_run

CODE = Path(measured_pairs.__file__).parents[2]


@pytest.fixture(scope="module")
def data(tmp_path_factory) -> Path:
    return toy_dataset(tmp_path_factory.mktemp("data"))


@pytest.fixture(scope="module")
def network(tmp_path_factory) -> Path:
    """Weights of a tiny transformer."""
    return trained_weights(tmp_path_factory.mktemp("vit-lie"), "vit-lie", TINY_VIT)


@pytest.fixture(scope="module")
def trial(data) -> measured_pairs.Trial:
    pairs = read_pairs(synthetic_run(data).read("pack"), "test")
    return measured_pairs.Trial.of(pairs, [0], PerturbationRange(), seed=0)


def _methods(network: Path) -> list[Method]:
    """One without a network and one with."""
    return chosen_methods(("hough", "vit-lie"), {"vit-lie": network}, xy_range_m=2.0, yaw_range_rad=0.8)


def _key(method: Method, trial: measured_pairs.Trial, *, workers: int = 1) -> str:
    return measuring.cache_key(measured_pairs.measurement(method, None, trial), workers=workers)


@pytest.mark.parametrize(
    ("source", "without_network", "with_network"),
    [
        ("evaluation/frame_error/estimates.py", True, True),
        ("stages/weights/estimators.py", True, True),
        ("commands/evaluate/measured_pairs.py", True, True),
        ("stages/weights/trained_estimators.py", True, True),
        ("training/frame_error/perturbation.py", True, True),
        ("alignment/window.py", True, True),
        ("baselines/hough.py", True, False),
        ("models/matcher.py", False, True),
        ("evaluation/report/page.py", False, False),
    ],
)
def test_outcomes_of_other_code_are_measured_anew(
    trial, network, tmp_path, monkeypatch, source, without_network, with_network
):
    shutil.copytree(CODE, tmp_path / "code", ignore=shutil.ignore_patterns("__pycache__"))
    monkeypatch.setattr(measuring, "_CODE", tmp_path / "code")
    methods = _methods(network)
    before = [_key(method, trial) for method in methods]
    with (tmp_path / "code" / source).open("a") as file:
        file.write("# changed\n")
    after = [_key(method, trial) for method in methods]
    assert [a != b for a, b in zip(after, before, strict=True)] == [without_network, with_network]


@pytest.mark.parametrize(
    ("package", "without_network"),
    [("numpy", True), ("scipy", True), ("opencv-python-headless", True), ("numba", True), ("torch", False)],
)
def test_outcomes_of_other_packages_or_workers_are_measured_anew(
    trial, network, monkeypatch, package, without_network
):
    methods, version = _methods(network), metadata.version
    before = [_key(method, trial) for method in methods]
    assert [_key(method, trial) for method in methods] == before
    more = [_key(method, trial, workers=2) for method in methods]
    assert all(a != b for a, b in zip(more, before, strict=True))
    monkeypatch.setattr(metadata, "version", lambda name: "0" if name == package else version(name))
    after = [_key(method, trial) for method in methods]
    assert [a != b for a, b in zip(after, before, strict=True)] == [without_network, True]
