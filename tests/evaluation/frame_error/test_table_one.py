from __future__ import annotations

import pytest
from rendezvous.evaluation.frame_error.table_one import ABLATION, HOUGH, LEARNED, METHODS, model_of, title


def test_rows_are_those_that_can_be_trained():
    losses = pytest.importorskip("rendezvous.models.losses")
    trainable = [(row.name, row.vit, row.reg, row.lie) for row in losses.ABLATION_ROWS]
    assert [(row.name, row.vit, row.reg, row.lie) for row in ABLATION] == trainable
    registry = pytest.importorskip("rendezvous.training.frame_error.registry")
    assert {model_of(name) for name in LEARNED} == set(registry.MODEL_NAMES)


def test_the_eight_rows_are_all_settings_of_three_switches():
    assert len({(row.vit, row.reg, row.lie) for row in ABLATION}) == 8
    assert title("vit-reg-lie") == "ViT + Reg + Lie"
    assert title("cnn") == "CNN"


def test_the_papers_best_row_is_its_transformer_with_the_lie_loss():
    best = min(ABLATION, key=lambda row: row.x_m + row.y_m)
    assert (best.vit, best.lie) == (True, True)
    assert HOUGH.x_m > best.x_m


def test_every_method_has_a_title_and_a_colour():
    colours = pytest.importorskip("rendezvous.evaluation.frame_error.charts").COLOURS
    assert set(colours) == set(METHODS)
    assert len({title(name) for name in METHODS}) == len(METHODS) == len(set(colours.values()))
