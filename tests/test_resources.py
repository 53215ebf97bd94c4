"""Shipped files stand in for files that are not there."""

from __future__ import annotations

from pathlib import Path

import pytest

from rendezvous.interop.houseexpo_files import count_plan_files, plan_files
from rendezvous.resources import ROOT, located


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def test_a_path_is_the_users_before_it_is_a_shipped_one(tmp_path: Path):
    assert located("stages.yaml") == ROOT / "stages.yaml"
    (tmp_path / "stages.yaml").touch()
    assert located("stages.yaml") == Path("stages.yaml")


def test_other_paths_stay_as_they_are():
    for name in ("nowhere.yaml", "/nowhere/stages.yaml", f"floorplans/../{'../' * 9}etc"):
        assert located(name) == Path(name)


def test_shipped_plans_go_by_the_same_names_wherever_the_package_lies(monkeypatch: pytest.MonkeyPatch):
    elsewhere = list(plan_files("floorplans"))
    assert len(elsewhere) == count_plan_files("floorplans") == 24
    assert elsewhere[3].source == "floorplans/rdv-003.json"
    monkeypatch.chdir(ROOT)
    assert list(plan_files("floorplans")) == elsewhere
