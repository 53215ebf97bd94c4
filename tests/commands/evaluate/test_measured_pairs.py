from __future__ import annotations

import shutil
from dataclasses import replace
from importlib import metadata
from pathlib import Path

import pytest

pytest.importorskip("matplotlib")
pytest.importorskip("torch")

from rendezvous.alignment.estimate import Identity
from rendezvous.alignment.window import DEFAULT_SEARCH, SearchRange
from rendezvous.commands.evaluate import measured_pairs, measuring
from rendezvous.methods import own_method
from rendezvous.stages.weights.estimators import SelectedMethod, select_methods
from rendezvous.training.frame_error.pairs import PerturbationRange, read_pairs
from tests.commands.evaluate.toy_evaluation import TINY_VIT, toy_dataset, trained_weights
from tests.synthetic_dataset import synthetic_run


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


def _key(selected: SelectedMethod, trial: measured_pairs.Trial, *, workers: int = 1) -> str:
    measuring._code_and_packages.cache_clear()
    return measuring.cache_key(measured_pairs.measurement(selected, None, trial), workers=workers)


@pytest.fixture
def selected(network) -> SelectedMethod:
    (found,) = select_methods(("vit-lie",), {"vit-lie": network}, search=DEFAULT_SEARCH)
    return found


def test_outcomes_of_other_code_packages_weights_or_workers_are_measured_anew(
    trial, selected, tmp_path, monkeypatch
):
    shutil.copytree(measuring._CODE, tmp_path / "code", ignore=shutil.ignore_patterns("__pycache__"))
    monkeypatch.setattr(measuring, "_CODE", tmp_path / "code")
    version, before = metadata.version, _key(selected, trial)
    assert _key(selected, trial) == before
    assert _key(selected, trial, workers=2) != before
    assert _key(replace(selected, search=SearchRange(xy_m=1.0, yaw_rad=0.1)), trial) != before
    (tmp_path / "other").write_bytes(selected.weights.read_bytes() + b" ")
    assert _key(replace(selected, weights=tmp_path / "other"), trial) != before
    for package in ("numpy", "numba", "torch"):
        monkeypatch.setattr(metadata, "version", lambda name, p=package: "0" if name == p else version(name))
        assert _key(selected, trial) != before, package
    monkeypatch.setattr(metadata, "version", version)
    with (tmp_path / "code" / "baselines" / "hough.py").open("a") as file:
        file.write("# changed\n")
    assert _key(selected, trial) != before
    measuring._code_and_packages.cache_clear()


def test_outcomes_of_a_users_method_are_not_kept_because_its_code_is_not_known(trial):
    mine = SelectedMethod(method=own_method("mine", Identity), search=DEFAULT_SEARCH)
    assert not measured_pairs.measurement(mine, None, trial).key
