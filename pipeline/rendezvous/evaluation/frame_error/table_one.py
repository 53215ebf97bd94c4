"""Table I of the paper (Kim, Han & Zhang, ICRA 2023), and where each of its rows stands here."""

from __future__ import annotations

from dataclasses import dataclass

OWN_METHODS = ("identity", "hough", "hough-global", "orb", "correlative", "matcher-maps", "matcher")
"""What is measured beside the paper's rows, in the order of tables."""

TITLES = {
    "identity": "Identity",
    "hough": "Hough, in the window",
    "hough-global": "Hough, global",
    "orb": "ORB + RANSAC",
    "correlative": "Correlative search",
    "matcher-maps": "Matcher, maps alone",
    "matcher": "Learned matcher",
}


@dataclass(frozen=True, slots=True, kw_only=True)
class PaperRow:
    """A row as it was printed.

    Attributes:
        name: what folders and options call the method.
        vit, reg, lie: the switches of the ablation; None for a method that has none.
        x_m, y_m, yaw_rad: mean absolute error on the paper's own test set, which is not public.
    """

    name: str
    vit: bool | None
    reg: bool | None
    lie: bool | None
    x_m: float
    y_m: float
    yaw_rad: float


def _row(name: str, x_m: float, y_m: float, yaw_rad: float) -> PaperRow:
    body, *options = name.split("-")
    return PaperRow(
        name=name,
        vit=body == "vit",
        reg="reg" in options,
        lie="lie" in options,
        x_m=x_m,
        y_m=y_m,
        yaw_rad=yaw_rad,
    )


ABLATION: tuple[PaperRow, ...] = (
    _row("cnn", 0.586, 0.591, 0.130),
    _row("cnn-lie", 0.562, 0.534, 0.167),
    _row("cnn-reg", 0.700, 0.692, 0.149),
    _row("cnn-reg-lie", 0.556, 0.570, 0.175),
    _row("vit", 0.999, 0.964, 0.394),
    _row("vit-lie", 0.425, 0.441, 0.097),
    _row("vit-reg", 0.638, 0.632, 0.138),
    _row("vit-reg-lie", 0.438, 0.426, 0.097),
)
HOUGH = PaperRow(name="hough-global", vit=None, reg=None, lie=None, x_m=1.096, y_m=1.175, yaw_rad=0.261)
"""The paper does not say whether its search was global; presumably it was, as published."""

PAPER = {row.name: row for row in (*ABLATION, HOUGH)}
LEARNED = ("matcher-maps", "matcher", *(row.name for row in ABLATION))
METHODS = (*OWN_METHODS, *(row.name for row in ABLATION))
"""All that can be measured."""


def model_of(name: str) -> str:
    """The model whose weights a learned method needs."""
    return "matcher" if name == "matcher-maps" else name


def title(name: str) -> str:
    """A method as tables call it."""
    if name in TITLES:
        return TITLES[name]
    row = PAPER[name]
    parts = ("Reg" if row.reg else "", "Lie" if row.lie else "")
    return " + ".join(["ViT" if row.vit else "CNN", *filter(None, parts)])
