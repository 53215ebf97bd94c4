from __future__ import annotations

from rendezvous.evaluation.relative_pose.gallery import chosen_images
from rendezvous.geometry.se2 import SE2
from tests.evaluation.toy_poses import mode, outcomes, read_as, truth

AHEAD = SE2(2.0, 0.0, 0.0)


def _found(*errors: tuple[float, ...]):
    poses = [read_as(mode(AHEAD @ SE2(*error).inverse())) for error in errors]
    return outcomes([truth(i, AHEAD) for i in range(len(errors))], poses)


def test_best_and_median_mind_the_heading_and_the_worst_are_of_both_kinds():
    errors = [(0.01, 0.0, 3.0), (0.01, 0.0, 0.01), (0.02, 0.0, 0.02), (0.9, 0.0, 0.0), (0.03, 0.0, 0.03)]
    chosen = chosen_images(_found(*errors), each=2)
    assert chosen[:2] == [("best", 1), ("best", 2)]
    assert {number for why, number in chosen if why == "worst"} == {0, 3}


def test_medians_are_those_in_the_middle_and_no_image_is_shown_twice():
    found = _found(*((0.01 * i, 0.0, 0.0) for i in range(9)))
    shown = [(why, number) for why, number in chosen_images(found, each=3) if why != "worst"]
    assert shown == [*(("best", i) for i in (0, 1, 2)), *(("median", i) for i in (3, 4, 5))]
    assert chosen_images(_found((0.1, 0.0, 0.1))) == [("best", 0)]


def test_missed_and_false_ones_are_shown_the_most_visible_and_the_surest_first():
    truths = [truth(0, AHEAD, visibility=0.3), truth(1, AHEAD, visibility=0.9)]
    truths += [truth(i, None) for i in (2, 3, 4)]
    false = [read_as(mode(AHEAD), score=score) for score in (0.6, 0.8)]
    found = outcomes(truths, [read_as(), read_as(), *false, read_as()])
    assert chosen_images(found, each=1) == [("missed", 1), ("false detection", 3)]
    assert [number for why, number in chosen_images(found, each=4) if why == "missed"] == [1, 0]
