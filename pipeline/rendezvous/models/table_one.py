"""Table I of the paper (Kim, Han & Zhang, ICRA 2023): its eight rows and their printed errors."""

from __future__ import annotations

from dataclasses import dataclass

DEFAULT_OMEGA = 0.1
"""Weight of the regulariser where it is on. The paper gives its range, [0, 1], not its value.

The pull of L_reg towards ξ = 0 is as strong for a small ξ as for a large one, that of L_error grows with the
error: they are level where the error is about ω. At 0.1 the regulariser wins only within a cell of the input.
"""

PrintedErrors = tuple[float, float, float]
"""Mean absolute error in x [m], y [m], yaw [rad] on the paper's own test set, which is not public."""


@dataclass(frozen=True, slots=True, kw_only=True)
class AblationRow:
    """A row of the ablation."""

    vit: bool  # the transformer; else the convolutional twin
    reg: bool  # with the regulariser of Eq. 6; else ω is 0
    lie: bool  # the loss of Eq. 5; else half the squared difference of x, y and yaw
    printed: PrintedErrors  # the row's errors in the paper

    @property
    def name(self) -> str:
        """As options and folders spell it, such as `vit-reg-lie`."""
        return "-".join(["vit" if self.vit else "cnn", *["reg"] * self.reg, *["lie"] * self.lie])

    @property
    def title(self) -> str:
        """As tables spell it, such as `ViT + Reg + Lie`."""
        return " + ".join(["ViT" if self.vit else "CNN", *["Reg"] * self.reg, *["Lie"] * self.lie])

    @property
    def omega(self) -> float:
        """ω of Eq. 7."""
        return DEFAULT_OMEGA if self.reg else 0.0


ABLATION_ROWS = (
    AblationRow(vit=False, reg=False, lie=False, printed=(0.586, 0.591, 0.130)),
    AblationRow(vit=False, reg=False, lie=True, printed=(0.562, 0.534, 0.167)),
    AblationRow(vit=False, reg=True, lie=False, printed=(0.700, 0.692, 0.149)),
    AblationRow(vit=False, reg=True, lie=True, printed=(0.556, 0.570, 0.175)),
    AblationRow(vit=True, reg=False, lie=False, printed=(0.999, 0.964, 0.394)),
    AblationRow(vit=True, reg=False, lie=True, printed=(0.425, 0.441, 0.097)),
    AblationRow(vit=True, reg=True, lie=False, printed=(0.638, 0.632, 0.138)),
    AblationRow(vit=True, reg=True, lie=True, printed=(0.438, 0.426, 0.097)),
)
"""In the order of the paper's table; the last is its method."""

PRINTED_HOUGH: PrintedErrors = (1.096, 1.175, 0.261)
"""The paper does not say whether its Hough search was global; presumably it was, as published."""
