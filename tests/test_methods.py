from __future__ import annotations

import pickle
from importlib.metadata import EntryPoint

import numpy as np
import pytest

from rendezvous import methods
from rendezvous.alignment.estimate import Estimate
from rendezvous.alignment.window import FREE_CELL, MapWindow, SearchRange
from rendezvous.baselines.hough import HoughSpectrum
from rendezvous.errors import ConfigError
from rendezvous.geometry.se2 import SE2
from rendezvous.methods import METHODS, REFINEMENTS, installed_methods, method_at, own_method
from rendezvous.models.table_one import ABLATION_ROWS, PRINTED_HOUGH

SEARCH = SearchRange(xy_m=1.0, yaw_rad=0.5)


class Still:
    """Finds that nothing is off."""

    name = "still"

    def __call__(self, window: MapWindow) -> Estimate:
        return Estimate(theta=SE2.identity())


class Searching(Still):
    def __init__(self, *, search: SearchRange) -> None:
        self.search = search


def test_every_method_has_a_title_and_a_colour_of_its_own():
    for field in ("title", "colour"):
        assert len({getattr(method, field) for method in METHODS.values()}) == len(METHODS) == 15
    assert all(name == method.name for name, method in METHODS.items())
    assert (METHODS["vit-reg-lie"].title, METHODS["cnn"].title) == ("ViT + Reg + Lie", "CNN")


def test_a_method_without_weights_has_a_factory_and_searches_where_it_should():
    window = MapWindow(cells=np.full((2, 64, 64), FREE_CELL, np.uint8), cell_m=0.1)
    simple = [method for method in METHODS.values() if not method.needs_weights]
    assert [method.name for method in simple] == ["identity", "hough", "hough-global", "orb", "correlative"]
    for method in simple:
        assert isinstance(method.estimator(SEARCH)(window), Estimate)
    assert METHODS["hough"].estimator(SEARCH).search == SEARCH
    assert METHODS["hough-global"].estimator(SEARCH) == HoughSpectrum()


def test_networks_need_the_weights_of_models_that_can_be_trained():
    registry = pytest.importorskip("rendezvous.training.frame_error.registry")
    models = {method.model for method in METHODS.values() if method.needs_weights}
    assert models == set(registry.MODEL_NAMES)
    assert METHODS["matcher-maps"].model == "matcher"


def test_the_papers_best_row_is_its_transformer_with_the_lie_loss():
    best = min(ABLATION_ROWS, key=lambda row: row.printed[0] + row.printed[1])
    assert (best.vit, best.lie, best.printed) == (True, True, METHODS[best.name].printed)
    assert METHODS["hough-global"].printed == PRINTED_HOUGH == (1.096, 1.175, 0.261)


def test_refinements_stand_in_the_order_of_tables_and_only_the_matchers_need_weights():
    assert list(REFINEMENTS) == ["none", "hough", "orb", "correlative", "learned", "auto"]
    assert [name for name, way in REFINEMENTS.items() if way.needs_matcher] == ["learned", "auto"]
    assert [name for name, way in REFINEMENTS.items() if way.refiner is None] == ["none", "learned", "auto"]
    assert [name for name, way in REFINEMENTS.items() if way.needs_covariance] == ["auto"]
    for name in ("hough", "orb", "correlative"):
        estimator, _ = REFINEMENTS[name].refiner(None)
        assert estimator.name.lower().startswith(name)


def test_a_users_method_is_given_the_search_if_it_asks_for_it():
    assert own_method("mine", Searching).estimator(SEARCH).search == SEARCH
    mine = pickle.loads(pickle.dumps(own_method("mine", Still)))
    assert isinstance(mine.estimator(SEARCH), Still)
    assert (mine.title, mine.shipped, mine.needs_weights) == ("mine", False, False)
    assert own_method("other", Still, number=1).colour != mine.colour


@pytest.mark.parametrize(
    ("name", "factory", "said"),
    [
        ("orb", Still, "'orb' is shipped already"),
        ("mine", 3, "3 is not a class or function"),
        ("mine", Still(), "is an estimator; give its class, or a function that returns it"),
    ],
)
def test_a_taken_name_and_what_makes_no_estimator_are_refused(name, factory, said):
    with pytest.raises(ConfigError, match=said):
        own_method(name, factory)


def test_a_method_is_found_by_its_place_and_a_wrong_place_is_refused(tmp_path, monkeypatch):
    (tmp_path / "mymethods.py").write_text("from rendezvous import Identity as Mine")
    monkeypatch.syspath_prepend(str(tmp_path))
    found = method_at("mymethods:Mine")
    assert (found.name, found.estimator(SEARCH).name) == ("Mine", "identity")
    for place in ("mymethods:Other", "nowhere:Mine", ":Mine", "mymethods:"):
        with pytest.raises(ConfigError, match=f"--methods {place}: .*; must be importable as package.module"):
            method_at(place)


def test_entry_points_of_installed_packages_add_methods(monkeypatch):
    def found(value: str, name: str = "theirs") -> list[str]:
        entry = EntryPoint(name=name, value=value, group=methods.ENTRY_POINTS)
        monkeypatch.setattr(methods, "entry_points", lambda group: [entry] if group == entry.group else [])
        installed_methods.cache_clear()
        return list(installed_methods())

    assert found(f"{__name__}:Still") == [*METHODS, "theirs"]
    with pytest.raises(ConfigError, match=r"entry point orb = .*: another method has that name"):
        found(f"{__name__}:Still", "orb")
    with pytest.raises(ConfigError, match="entry point theirs = nowhere:X: No module named 'nowhere'"):
        found("nowhere:X")
    installed_methods.cache_clear()
