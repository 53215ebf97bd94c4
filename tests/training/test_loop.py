"""The loop: a run that was killed goes on to the same curve; time, rate, decay and average as stated."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from rendezvous.errors import ConfigError
from rendezvous.training.batches import training_loader
from rendezvous.training.checkpoint import checkpoint_bytes, read_checkpoint, restore_in_place
from rendezvous.training.frame_error.data import TrainingBatches
from rendezvous.training.frame_error.pairs import PairTable
from rendezvous.training.loop import (
    Processes,
    Step,
    TrainingState,
    adamw,
    fit,
    learning_rate,
    update_average,
    with_precision,
)
from rendezvous.training.parameters import Budget, Optimisation
from tests.training.tiny import SAMPLING, Losses, tiny_model

SETTINGS = Optimisation(batch_size=4, learning_rate=1e-2)
BUDGET = Budget(samples=48, duration_s=None)


def trained(
    pairs: PairTable,
    state: TrainingState,
    *,
    settings: Optimisation = SETTINGS,
    budget: Budget = BUDGET,
    killed_after: int | None = None,
    clock=lambda: 0.0,
) -> list[float]:
    batches = TrainingBatches(pairs, SAMPLING, seed=0, batch_size=settings.batch_size)
    losses = Losses(killed_after=killed_after)
    loader = training_loader(batches, first_step=state.step, workers=0, pin_memory=False)
    options = {"seed": 0, "processes": Processes(), "observer": losses, "clock": clock}
    if killed_after is None:
        fit(state, loader, settings, budget, **options)
    else:
        with pytest.raises(KeyboardInterrupt):
            fit(state, loader, settings, budget, **options)
    return losses.losses


def test_each_step_has_its_own_random_numbers_and_the_same_ones_again(pairs: PairTable, monkeypatch):
    """Dropout draws from them: a run that goes on draws what an undisturbed one does."""
    draws: list[float] = []
    loss = type(tiny_model()).loss

    def drawing(model, batch):
        draws.append(float(torch.rand(1)))
        return loss(model, batch)

    monkeypatch.setattr(type(tiny_model()), "loss", drawing)
    for _ in range(2):
        trained(pairs, TrainingState.fresh(tiny_model(), SETTINGS))
    assert draws[:12] == draws[12:]
    assert len(set(draws)) == 12


def test_a_killed_run_goes_on_to_the_same_curve(pairs: PairTable):
    whole = TrainingState.fresh(tiny_model(), SETTINGS)
    losses = trained(pairs, whole)
    assert len(losses) == 12
    killed = TrainingState.fresh(tiny_model(), SETTINGS)
    before = trained(pairs, killed, killed_after=5)
    checkpoint = read_checkpoint(checkpoint_bytes(killed, {}), where="here")
    resumed = TrainingState.fresh(tiny_model(seed=1), SETTINGS)
    restore_in_place(resumed, checkpoint, where="here")
    assert resumed.samples == 20
    after = trained(pairs, resumed)
    assert before + after == pytest.approx(losses, abs=1e-6)
    for name, value in whole.average.state_dict().items():
        assert torch.allclose(resumed.average.state_dict()[name], value, atol=1e-6)
    assert resumed.loss_sum == pytest.approx(whole.loss_sum, abs=1e-5)
    assert (resumed.step, resumed.loss_steps) == (12, 12)


def test_training_lowers_the_loss(pairs: PairTable):
    losses = trained(
        pairs, TrainingState.fresh(tiny_model(), SETTINGS), budget=Budget(samples=400, duration_s=None)
    )
    assert np.mean(losses[-20:]) < 0.8 * np.mean(losses[:10])


def test_training_ends_by_time_also_after_a_kill(pairs: PairTable):
    ticks = iter(range(1000))
    state = TrainingState.fresh(tiny_model(), SETTINGS)
    state.elapsed_s = 90.0  # before the kill
    trained(pairs, state, budget=Budget(samples=None, duration_s=100.0), clock=lambda: float(next(ticks)))
    # The clock is read once to begin, then before and after each step, until 10 s have gone.
    assert state.step == 5


def test_a_loss_that_is_not_finite_is_told_and_leaves_the_weights_alone(pairs: PairTable):
    state = TrainingState.fresh(tiny_model(), SETTINGS)
    with torch.no_grad():
        state.model.layers[3].bias[0] = torch.nan
    before = state.model.layers[0].weight.clone()
    with pytest.raises(ConfigError, match=r"step 0: the loss is nan.*learning_rate or precision fp32"):
        trained(pairs, state)
    assert torch.equal(state.model.layers[0].weight, before)


@pytest.mark.parametrize(
    ("capabilities", "precision"),
    [
        ({"avx2": True, "avx512_bf16": False}, "fp32"),
        ({"avx2": True, "avx512_bf16": True}, "bf16"),
        ({"amx_bf16": True, "avx_ne_convert": False}, "bf16"),
    ],
)
def test_bfloat16_is_used_where_the_cpu_computes_in_it(
    monkeypatch: pytest.MonkeyPatch, capabilities: dict[str, bool], precision: str
):
    monkeypatch.setattr(torch.cpu, "get_capabilities", lambda: capabilities)
    assert with_precision(Optimisation(), torch.device("cpu")).precision == precision
    assert with_precision(Optimisation(precision="fp32"), torch.device("cpu")).precision == "fp32"
    assert with_precision(Optimisation(precision="bf16"), torch.device("cpu")).precision == "bf16"


def test_the_rate_rises_along_a_line_and_falls_along_a_cosine():
    settings = Optimisation(warmup_share=0.1, final_share=0.1)
    rates = [learning_rate(spent, settings, highest=2.0) for spent in (0.05, 0.1, 0.55, 1.0)]
    assert rates == pytest.approx([1.0, 2.0, 1.1, 0.2])
    assert learning_rate(0.0, settings, highest=2.0) > 0.0
    assert learning_rate(0.0, Optimisation(warmup_share=0.0), highest=2.0) == 2.0


def test_the_rate_is_the_models_own_unless_one_is_set(pairs: PairTable):
    moved = []
    for rate in (None, 1e-2, 1e-3):
        state = TrainingState.fresh(tiny_model(), SETTINGS)
        settings = Optimisation(batch_size=4, learning_rate=rate)
        trained(pairs, state, settings=settings, budget=Budget(samples=8, duration_s=None))
        moved.append(state.model.layers[0].weight.detach().clone())
    assert torch.equal(moved[0], moved[1])
    assert not torch.equal(moved[0], moved[2])


def test_biases_and_gains_do_not_decay():
    model = tiny_model()
    optimizer = adamw(model, Optimisation(weight_decay=0.5))
    decayed, spared = (
        {name for name, p in model.named_parameters() if any(p is q for q in group["params"])}
        for group in optimizer.param_groups
    )
    assert [group["weight_decay"] for group in optimizer.param_groups] == [0.5, 0.0]
    assert decayed == {"layers.0.weight", "layers.3.weight"}
    assert spared == {"layers.0.bias", "layers.1.weight", "layers.1.bias", "layers.3.bias"}


def test_the_average_follows_its_formula_and_asks_for_no_gradient():
    model, moved = tiny_model(), tiny_model(seed=1)
    average = TrainingState.fresh(model, SETTINGS).average
    update_average(average, moved, step=10, decay=0.9)  # 10 / 20 is kept
    expected = 0.5 * model.layers[0].weight + 0.5 * moved.layers[0].weight
    assert torch.allclose(average.layers[0].weight, expected, atol=1e-6)
    update_average(average, moved, step=10**6, decay=0.9)
    expected = 0.9 * expected + 0.1 * moved.layers[0].weight
    assert torch.allclose(average.layers[0].weight, expected, atol=1e-6)
    assert not any(p.requires_grad for p in average.parameters())
    assert not average.training


def test_a_budget_ends_with_its_first_bound():
    budget = Budget(samples=100, duration_s=10.0)
    assert budget.spent(50, 1.0) == 0.5
    assert budget.spent(50, 9.0) == 0.9
    assert math.isclose(Budget(samples=None, duration_s=4.0).spent(10**9, 1.0), 0.25)


def test_gradients_are_clipped_and_each_step_tells_its_norm_rate_and_share(pairs: PairTable):
    settings = Optimisation(batch_size=4, learning_rate=1e-2, clip_norm=1e-3, precision="fp32")
    state, steps = TrainingState.fresh(tiny_model(), settings), []

    class Watching:
        def after(self, state: TrainingState, step: Step) -> None:
            norms = [p.grad.norm() for p in state.model.parameters() if p.grad is not None]
            steps.append((step, float(torch.stack(norms).norm())))

    batches = TrainingBatches(pairs, SAMPLING, seed=0, batch_size=4)
    loader = training_loader(batches, first_step=0, workers=0, pin_memory=False)
    fit(
        state, loader, settings, BUDGET, seed=0, processes=Processes(), observer=Watching(), clock=lambda: 0.0
    )
    assert [clipped for _, clipped in steps] == pytest.approx([1e-3] * 12, rel=1e-3)
    assert min(step.gradient_norm for step, _ in steps) > 1e-2
    assert [step.spent for step, _ in steps] == pytest.approx([k / 12 for k in range(12)])
    rates = [learning_rate(k / 12, settings, highest=1e-2) for k in range(12)]
    assert [step.learning_rate for step, _ in steps] == pytest.approx(rates)
    assert state.optimizer.param_groups[-1]["lr"] == pytest.approx(rates[-1])
