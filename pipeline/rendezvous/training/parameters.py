"""Parameters of a training run. Imports no PyTorch: the configuration is read without it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from rendezvous.alignment.window import WINDOW_CELL_M, WINDOW_CELLS
from rendezvous.errors import require_within
from rendezvous.training.frame_error.augmentation import Augmentation
from rendezvous.training.frame_error.pairs import PerturbationRange


@dataclass(frozen=True, slots=True, kw_only=True)
class Sampling:
    """How samples are drawn from pairs."""

    perturbation: PerturbationRange = field(default_factory=PerturbationRange)  # the range of frame errors
    augmentation: Augmentation = field(default_factory=Augmentation)  # defects of the maps
    sight_withheld: float = 0.3  # share of samples without the robots' positions and sight
    # window_cells, window_cell_m: cells along a side of the window, and their side.
    window_cells: int = WINDOW_CELLS
    window_cell_m: float = WINDOW_CELL_M

    def __post_init__(self) -> None:
        require_within(self, sight_withheld=(0.0, 1.0), window_cells=(16, 4096), window_cell_m=(0.01, 1.0))


@dataclass(frozen=True, slots=True, kw_only=True)
class Optimisation:
    """AdamW, a learning rate that rises, then falls along a cosine, and a moving average of the weights."""

    batch_size: int = 8  # samples of each process in a step
    learning_rate: float | None = None  # the highest; None for the one that suits the model
    final_share: float = 0.01  # share of it that is left at the end
    warmup_share: float = 0.03  # share of the budget over which it rises from 0
    weight_decay: float = 0.02  # of weights; biases and gains of norms have none
    clip_norm: float = 1.0  # largest norm of the gradient
    ema_decay: float = 0.998  # of the moving average of the weights, which is validated and published
    precision: Literal["bf16", "fp32"] | None = None  # of the forward pass; None: bf16 where the chip has it

    def __post_init__(self) -> None:
        require_within(
            self,
            batch_size=(1, 65536),
            final_share=(0.0, 1.0),
            warmup_share=(0.0, 0.5),
            weight_decay=(0.0, 1.0),
            clip_norm=(1e-6, 1e6),
            ema_decay=(0.0, 0.999999),
        )
        if self.learning_rate is not None:
            require_within(self, learning_rate=(1e-8, 1.0))


@dataclass(frozen=True, slots=True, kw_only=True)
class Budget:
    """When training ends: after so many samples or seconds, whichever comes first.

    The learning rate follows the share that is spent. With a bound in seconds it depends on the clock: only a
    run bounded by samples alone repeats its curve exactly after a kill.
    """

    samples: int | None
    duration_s: float | None

    def __post_init__(self) -> None:
        assert self.samples is not None or self.duration_s is not None, "a budget has a bound"

    def spent(self, samples: int, elapsed_s: float) -> float:
        """Share of the budget that is spent; 1 or more at the end."""
        by_samples = samples / self.samples if self.samples is not None else 0.0
        by_time = elapsed_s / self.duration_s if self.duration_s is not None else 0.0
        return max(by_samples, by_time)
