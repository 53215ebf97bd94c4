"""How to read the tables of the report on frame-error estimators, and what they do not show."""

from __future__ import annotations

from rendezvous.evaluation.frame_error.measured_row import Conditions
from rendezvous.evaluation.frame_error.training_curve import STILL_FALLING
from rendezvous.evaluation.statistics import LEVEL, RESAMPLES

TASK = (
    "Two maps of one building are laid over each other by a transform that is wrong. Every method sees both "
    "in a window around the meeting point, and says by which rigid motion θ the second one is off. The "
    "learned matcher is told as well where the robots stood as one saw the other; “maps alone” is the same "
    "weights without that. A method's error is θ̂⁻¹ θ. All are measured on the same pairs, wrong by the same "
    "motions."
)

SHARES = (
    "Intervals of shares take pairs as independent; pairs of one floor plan are not: they are too narrow."
)

OVERLAP = (
    "Mean position error, mean heading error, and success, by how much of the ground both robots know: "
    f"|known by both| / |known by either|. {SHARES}"
)


def table_one_note(conditions: Conditions) -> str:
    """Below Table I."""
    c = conditions
    return (
        f"Frame errors are uniform over ±{c.xy_range_m:g} m, ±{c.xy_range_m:g} m, ±{c.yaw_range_deg:g}°. The "
        "paper does not state its range: ±2 m, ±2 m, ±45° is inferred from the row of its table that failed "
        "to learn, whose errors are those of answering zero. Its pairs are not public, so its columns stand "
        "beside ours for orientation only. Its one Hough row is presumably the global method. Constants of "
        "the correlative search were chosen on pairs some of which are of test plans, which may favour it. "
        f"Small figures are {100 * LEVEL:.0f} % intervals: of means by {RESAMPLES:,} bootstrap resamples of "
        f"whole floor plans, of shares by Wilson's formula. {SHARES} Where a method finds no estimate, its "
        "error is that of making no correction, and it counts as no success; “95 % below” is position, then "
        "heading. “Not converged”: over the last quarter of training the validation error still fell by more "
        f"than {100 * STILL_FALLING:.0f} %; “convergence not known”: no curve beside the weights tells. “Has "
        "not learned”: the mean error is near that of answering zero. “Recorded” rows are from an earlier "
        "run on the same split, told beside them; rows that nobody has trained stay empty."
    )


def comparison_note(count: int) -> str:
    """Below so many comparisons."""
    return (
        "The best method against each other one: differences on the same pairs, best minus other, with "
        "paired bootstrap intervals. “Better in” names what the interval leaves no doubt about, taken alone: "
        f"each of the {3 * count} intervals is of {100 * LEVEL:.0f} % for itself, not corrected for their "
        "number, and the best was picked by these very pairs."
    )
