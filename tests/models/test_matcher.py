"""Signs, laws and learning of the matcher, on maps with a known frame error."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor, nn

from rendezvous.alignment.frame_error import pose_difference
from rendezvous.alignment.window import OCCUPIED_CELL, OPEN_CELL, MapWindow, SearchRange
from rendezvous.errors import ConfigError
from rendezvous.geometry.se2 import SE2
from rendezvous.models.matcher import Matcher, MatcherConfig, correlation, fft_size, moved, se2_scores
from rendezvous.models.matcher_calibration import MatcherCalibration
from rendezvous.models.matcher_estimator import MatcherEstimator
from rendezvous.models.matcher_loss import LossSampling, matcher_loss
from rendezvous.models.posterior import Gaussian
from tests.models.worlds import misplaced, rooms

SMALL = MatcherConfig(
    cell_m=0.1, coarse_factor=2, fine_factor=1, channels=8, dilations=(1, 2), fine_channels=4
)
"""Like the default in its feature cells, but takes windows at 0.1 m."""
THETA = SE2(1.4, -0.7, math.radians(24.0))


class SmoothedWalls(nn.Module):
    """An encoder without weights: both features are the occupied cells, smoothed."""

    def forward(self, cells_BNN: Tensor, sight_BNN: Tensor) -> tuple[Tensor, Tensor]:
        fine = (cells_BNN[:, None] == OCCUPIED_CELL).float()
        fine = nn.functional.avg_pool2d(fine, 3, stride=1, padding=1)
        return nn.functional.avg_pool2d(fine, 2), fine


def wall_matcher() -> Matcher:
    """A matcher that compares the walls themselves."""
    matcher = Matcher(SMALL).eval()
    matcher.encoder = SmoothedWalls()  # type: ignore[assignment]
    with torch.no_grad():
        matcher.fine_log_scale.fill_(0.0)
        matcher.coarse_log_scale.fill_(0.0)
    return matcher


def window_of(theta: SE2, *, seed: int = 1, size: int = 192) -> MapWindow:
    return misplaced(rooms(np.random.default_rng(seed)), theta, cells=size, cell_m=0.1)


def is_near(found: SE2 | None, theta: SE2, *, within_m: float, within_deg: float) -> bool:
    assert found is not None
    off = pose_difference(found, theta)
    return math.hypot(off.x_m, off.y_m) < within_m and abs(off.yaw_rad) < math.radians(within_deg)


def test_correlation_is_the_sum_over_cells_at_every_slide():
    a, b = torch.randn(1, 2, 3, 6, 6), torch.randn(1, 2, 6, 6)
    slides = torch.arange(-2.0, 3.0).expand(1, 3, -1)
    found = correlation(a, b, slides, slides, 8)
    padded = nn.functional.pad(b, (2, 2, 2, 2))
    for row in range(5):
        for col in range(5):
            shifted = padded[:, :, None, row : row + 6, col : col + 6]
            assert found[..., row, col] == pytest.approx((a * shifted).sum((1, 3, 4)), abs=1e-4)


def test_correlation_between_cells_is_the_spectrum_s_interpolation():
    generator = torch.Generator().manual_seed(0)
    b = torch.rand(1, 1, 4, 4, generator=generator, dtype=torch.double)
    a = torch.zeros(1, 1, 1, 4, 4, dtype=torch.double)
    a[..., 0, 0] = 1.0
    spectrum = torch.fft.fft2(b[0, 0], s=(8, 8)).numpy()
    # Strictly below half the sampling rate there is only one trigonometric interpolant.
    spectrum[4], spectrum[:, 4] = 0.0, 0.0
    smooth = torch.from_numpy(np.fft.ifft2(spectrum).real)[None, None]
    y, x = torch.tensor([[[0.3, 1.6]]]).double(), torch.tensor([[[0.9]]]).double()
    found = correlation(a, smooth, y, x, 8)
    k = np.fft.fftfreq(8) * math.tau
    waves = np.exp(1j * (k[:, None] * np.array([0.3, 1.6])[:, None, None] + k * 0.9))
    assert found[0, 0, :, 0].numpy() == pytest.approx((spectrum * waves).sum((1, 2)).real / 64)


def test_correlation_s_gradient_is_its_derivative():
    generator = torch.Generator().manual_seed(0)
    a = torch.randn(1, 2, 2, 5, 5, generator=generator, dtype=torch.double, requires_grad=True)
    b = torch.randn(1, 2, 5, 5, generator=generator, dtype=torch.double, requires_grad=True)
    y, x = (torch.randn(1, 2, n, generator=generator, dtype=torch.double) for n in (3, 4))
    assert torch.autograd.gradcheck(lambda a, b: correlation(a, b, y, x, 8), (a, b))


def test_a_grid_turned_by_a_quarter_holds_at_p_what_was_at_the_quarter_back():
    grid = torch.arange(16.0).reshape(1, 1, 4, 4)
    found = moved(grid, torch.tensor([[0.0, math.pi / 2]]))
    assert found[0, 0, 0].numpy() == pytest.approx(grid[0, 0].numpy())
    # Rows grow with y: what was ahead on +x comes to lie on +y.
    assert found[0, 0, 1].numpy() == pytest.approx(np.rot90(grid[0, 0].numpy(), -1), abs=1e-4)


def test_a_grid_is_turned_first_and_shifted_then():
    grid = torch.arange(16.0).reshape(1, 1, 4, 4)
    turn = torch.tensor([[math.pi / 2]])
    found = moved(grid, turn, torch.tensor([[[2.0, -1.0]]]))[0, 0, 0]
    assert found[:3, 2:].numpy() == pytest.approx(moved(grid, turn)[0, 0, 0, 1:, :2].numpy(), abs=1e-4)
    assert found[3:].abs().max() == found[:, :2].abs().max() == 0.0


@pytest.mark.parametrize("whole_range", [True, False])
def test_what_slides_out_of_the_window_does_not_come_back_on_the_other_side(whole_range):
    a, b = torch.zeros(1, 1, 8, 8), torch.zeros(1, 1, 8, 8)
    a[..., 4, 7], b[..., 4, 1] = 1.0, 1.0
    y, x = torch.zeros(1, 1, 1), torch.tensor([[[-6.0, 2.0]]])
    found = se2_scores(a, b, torch.zeros(1, 1), y, x if whole_range else x[..., 1:], whole_range=whole_range)
    assert found[..., -1].item() == pytest.approx(0.0, abs=1e-5)
    back = se2_scores(a, b, torch.zeros(1, 1), y, x[..., :1], whole_range=whole_range)
    assert back.item() == pytest.approx(1.0, abs=1e-4)


def test_both_ways_of_sliding_give_the_same_scores():
    generator = torch.Generator().manual_seed(0)
    a, b = (nn.functional.pad(torch.randn(1, 2, 8, 8, generator=generator), [4] * 4) for _ in range(2))
    heading = torch.full((1, 1), 0.3)
    slides = torch.tensor([[[1.0, 2.0, 3.0]]])
    near, far = (se2_scores(a, b, heading, slides, slides, whole_range=whole) for whole in (False, True))
    assert near.numpy() == pytest.approx(far.numpy(), abs=1e-3)


def test_pairs_do_not_meet_in_a_batch():
    generator = torch.Generator().manual_seed(0)
    a, b = (torch.randn(3, 2, 8, 8, generator=generator) for _ in range(2))
    heading = torch.rand(3, 4, generator=generator)
    slides = torch.arange(-2.0, 3.0).expand(3, 4, -1)
    together = se2_scores(a, b, heading, slides, slides, whole_range=True)
    alone = se2_scores(a[1:2], b[1:2], heading[1:2], slides[1:2], slides[1:2], whole_range=True)
    assert together[1].numpy() == pytest.approx(alone[0].numpy(), abs=1e-4)


@pytest.mark.parametrize(("cells", "size"), [(96, 96), (97, 128), (128, 128), (129, 192), (1, 1), (5, 6)])
def test_fft_size_is_the_least_quick_one(cells, size):
    assert fft_size(cells) == size


def test_walls_that_are_correlated_peak_at_theta():
    matcher, window = wall_matcher(), window_of(THETA)
    features = matcher.features(torch.from_numpy(window.cells)[None])
    headings = torch.deg2rad(torch.arange(-45.0, 46.0, 3.0))[None]
    volume = matcher.coarse_scores(features, headings, 14)[0]
    h, y, x = np.unravel_index(int(volume.argmax()), volume.shape)
    assert headings[0, h] == pytest.approx(THETA.yaw_rad)
    assert 0.2 * (x - 14) == pytest.approx(THETA.x_m, abs=0.11)
    assert 0.2 * (y - 14) == pytest.approx(THETA.y_m, abs=0.11)


def test_fine_and_coarse_scores_peak_at_the_same_place():
    matcher, window = wall_matcher(), window_of(THETA)
    features = matcher.features(torch.from_numpy(window.cells)[None])
    headings = THETA.yaw_rad + torch.deg2rad(torch.arange(-3.0, 3.5, 1.0))[None]
    offsets = 0.04 * torch.arange(-8.0, 9.0)
    y_m, x_m = ((centre + offsets).expand(1, 7, -1) for centre in (THETA.y_m, THETA.x_m))
    volume = matcher.fine_scores(features, headings, y_m, x_m)[0]
    h, y, x = np.unravel_index(int(volume.argmax()), volume.shape)
    assert h == 3
    assert max(abs(offsets[y]), abs(offsets[x])) < 0.05


@pytest.mark.parametrize(
    "theta", [SE2.identity(), THETA, SE2(-2.3, 1.9, -0.75)], ids=["none", "one way", "the other way"]
)
def test_estimator_finds_theta_in_the_default_search(theta):
    estimate = MatcherEstimator(model=wall_matcher())(window_of(theta))
    assert is_near(estimate.theta, theta, within_m=0.05, within_deg=0.5)
    assert np.linalg.eigvalsh(estimate.covariance).min() > 0.0
    assert not estimate.ambiguous


def test_sharpness_narrows_the_covariance_alone():
    matcher, window = wall_matcher(), window_of(THETA)
    with torch.no_grad():
        matcher.fine_log_scale.fill_(math.log(0.02))
    plain, sharp = (
        MatcherEstimator(model=matcher, calibration=MatcherCalibration(sharpness=sharpness)).posterior(window)
        for sharpness in (1.0, 2.0)
    )
    ratio = np.diag(sharp.best().covariance) / np.diag(plain.best().covariance)
    # Half for a Gaussian peak; walls make one with heavier tails.
    assert ((ratio > 0.3) & (ratio < 0.55)).all()
    assert (sharp.masses == plain.masses).all()


def test_a_search_of_no_width_still_has_neighbours_to_compare():
    search = SearchRange(xy_m=0.0, yaw_rad=0.0)
    estimate = MatcherEstimator(model=wall_matcher(), search=search)(window_of(SE2.identity()))
    assert is_near(estimate.theta, SE2.identity(), within_m=0.05, within_deg=0.5)


@pytest.mark.parametrize("yaw_deg", [-178.9, 120.0, 180.0])
def test_estimator_searches_all_headings_and_four_metres(yaw_deg):
    theta = SE2(3.7, -3.2, math.radians(yaw_deg))
    search = SearchRange(xy_m=4.0, yaw_rad=math.pi)
    posterior = MatcherEstimator(model=wall_matcher(), search=search).posterior(window_of(theta))
    assert posterior.coarse.headings_rad.size == 120
    assert is_near(posterior.best().mean, theta, within_m=0.05, within_deg=0.5)


NETWORK_ALONE = MatcherCalibration(of_network=1.0, of_evidence=(0.0, 0.0, 0.0, 0.0))


def two_likely_places() -> MatcherEstimator:
    """A matcher that cannot tell, and two priors of different widths, as likely as each other."""
    matcher = wall_matcher()
    with torch.no_grad():
        matcher.fine_log_scale.fill_(-30.0)
        matcher.coarse_log_scale.fill_(-30.0)
    narrow = Gaussian(mean=SE2(-1.0, 0.4, -0.3), covariance=np.diag([0.05, 0.05, 0.014]) ** 2)
    wide = Gaussian(mean=SE2(1.0, 0.0, 0.3), covariance=np.diag([0.1, 0.1, 0.02]) ** 2)
    return MatcherEstimator(model=matcher, priors=(narrow, wide), calibration=NETWORK_ALONE)


def test_peaks_weigh_by_their_volume_not_their_cells():
    posterior = two_likely_places().posterior(window_of(THETA))
    assert posterior.masses == pytest.approx([0.5, 0.5], abs=0.05)
    assert posterior.masses.sum() + np.exp(posterior.rest.log_p_HYX).sum() == pytest.approx(1.0)


def test_a_prior_narrower_than_a_coarse_cell_is_not_missed_between_cells():
    estimator = two_likely_places()
    narrow = replace(estimator.priors[0], mean=SE2(-1.1, 0.5, -0.3), covariance=np.eye(3) * 1e-4)
    posterior = replace(estimator, priors=(narrow, estimator.priors[1])).posterior(window_of(THETA))
    assert posterior.coarse.modes(2)[1].mass > 0.2


def test_what_was_not_looked_at_keeps_its_share():
    posterior = replace(two_likely_places(), peaks=1).posterior(window_of(THETA))
    assert len(posterior.pieces) == 1
    (looked_at,) = posterior.coarse.modes(1)
    assert 0.2 < looked_at.mass < 0.8
    assert posterior.masses == pytest.approx([looked_at.mass], abs=0.01)
    assert np.exp(posterior.rest.log_p_HYX).sum() == pytest.approx(1.0 - looked_at.mass, abs=0.01)


def test_no_peak_is_counted_twice():
    torch.manual_seed(0)
    estimator = MatcherEstimator(model=Matcher(SMALL).eval())
    posterior = estimator.posterior(window_of(THETA))
    assert len(estimator._worth_a_look(posterior.coarse)) > 1
    middles = [piece.middle() for piece in posterior.pieces]
    for k, piece in enumerate(posterior.pieces):
        assert not any(piece.holds(middle) for middle in middles[:k] + middles[k + 1 :])


def test_an_untrained_matcher_says_that_it_does_not_know():
    torch.manual_seed(0)
    alone = MatcherEstimator(model=Matcher(SMALL).eval(), calibration=NETWORK_ALONE)
    assert alone(window_of(THETA)).ambiguous


def test_the_walls_speak_for_theta_where_the_network_says_nothing():
    torch.manual_seed(0)
    estimate = MatcherEstimator(model=Matcher(SMALL).eval())(window_of(THETA))
    assert is_near(estimate.theta, THETA, within_m=0.3, within_deg=3.0)


def test_a_large_overlap_that_contradicts_itself_loses_to_a_small_one_that_agrees():
    """The prior prefers a placement that lays walls on floor, and the network says nothing."""
    estimator = two_likely_places()
    window = window_of(THETA)
    true = Gaussian(mean=THETA, covariance=np.diag([0.05, 0.05, 0.014]) ** 2, weight=0.01)
    false = replace(true, mean=SE2(-1.0, 0.4, -0.3), weight=0.99)
    told = replace(estimator, priors=(true, false))
    assert is_near(told(window).theta, false.mean, within_m=0.3, within_deg=3.0)
    asked = replace(told, calibration=MatcherCalibration())
    assert is_near(asked(window).theta, THETA, within_m=0.3, within_deg=3.0)


def test_a_prior_chooses_between_a_map_and_its_half_turn():
    """A scene that looks the same upside down: the prior alone can tell."""
    cells = window_of(SE2.identity()).cells[0]
    both_ways = np.maximum(cells, cells[::-1, ::-1])
    window = MapWindow(cells=np.stack([both_ways, both_ways]), cell_m=0.1)
    search = SearchRange(xy_m=1.0, yaw_rad=math.pi)
    wide = np.diag([0.5, 0.5, 0.3]) ** 2
    assert MatcherEstimator(model=wall_matcher(), search=search)(window).ambiguous
    for yaw_rad in (0.1, math.pi - 0.1):
        prior = Gaussian(mean=SE2(0.0, 0.0, yaw_rad), covariance=wide)
        estimate = MatcherEstimator(model=wall_matcher(), search=search, priors=(prior,))(window)
        assert not estimate.ambiguous
        truth = SE2(0.0, 0.0, round(yaw_rad / math.pi) * math.pi)
        assert is_near(estimate.theta, truth, within_m=0.02, within_deg=0.5)


def test_a_map_with_nothing_in_the_window_gives_no_estimate():
    window = window_of(THETA)
    empty = MapWindow(cells=window.cells * np.array([1, 0], np.uint8)[:, None, None], cell_m=0.1)
    estimate = MatcherEstimator(model=wall_matcher())(empty)
    assert estimate.theta is None
    assert "nothing known" in estimate.reason


def test_features_are_zero_far_from_what_is_known():
    cells = torch.zeros(1, 1, 192, 192, dtype=torch.uint8)
    cells[..., 90:96, 90:96] = OCCUPIED_CELL
    features = Matcher(SMALL).features(cells.expand(1, 2, -1, -1))
    assert features.coarse_BMFYX.abs().sum() > 0.0
    assert features.coarse_BMFYX[..., :37, :].abs().max() == 0.0
    assert features.fine_BMFYX[..., : 2 * 37, :].abs().max() == 0.0


def batch_of(count: int, *, seed: int = 0, size: int = 192) -> dict[str, Tensor]:
    rng = np.random.default_rng(seed)
    thetas = rng.uniform(-1.0, 1.0, (count, 3)) * [2.0, 2.0, math.pi / 4]
    cells = [window_of(SE2.from_array(theta), seed=i, size=size).cells for i, theta in enumerate(thetas)]
    windows = torch.from_numpy(np.stack(cells))
    sight = torch.randint(0, 3, windows.shape, generator=torch.Generator().manual_seed(seed)).to(torch.uint8)
    return {"cells": windows, "sight": sight, "theta": torch.from_numpy(thetas).float()}


def loss_of(matcher: Matcher, batch: dict[str, Tensor]) -> tuple[Tensor, dict[str, float]]:
    return matcher_loss(matcher, batch["cells"], batch["theta"], LossSampling(), sight_BMNN=batch["sight"])


@pytest.mark.parametrize("turned_share", [0.0, 1.0])
def test_the_loss_is_lower_for_the_true_theta_than_for_another(turned_share):
    matcher, batch = wall_matcher(), batch_of(3)
    looks = LossSampling(turned_share=turned_share)
    with torch.no_grad():
        true, parts = matcher_loss(matcher, batch["cells"], batch["theta"], looks)
        others = [
            matcher_loss(matcher, batch["cells"], batch["theta"] + torch.tensor(offset), looks)[0]
            for offset in ([0.5, 0.0, 0.0], [0.0, 0.0, 0.2])
        ]
    assert true < min(others) - 2.0
    assert parts["true_mass"] > 0.99
    assert float(true) == pytest.approx(parts["coarse"] + parts["fine"], rel=1e-5)


def test_the_loss_of_a_batch_is_always_the_same():
    torch.manual_seed(0)
    matcher, batch = Matcher(SMALL), batch_of(2)
    with torch.no_grad():
        first, again = loss_of(matcher, batch)[0], loss_of(matcher, batch)[0]
    assert first == again


def test_an_indifferent_matcher_s_loss_is_the_logarithm_of_the_volume():
    matcher, batch = wall_matcher(), batch_of(1)
    with torch.no_grad():
        matcher.coarse_log_scale.fill_(-30.0)
        matcher.fine_log_scale.fill_(-30.0)
        _, parts = loss_of(matcher, batch)
    # 120 headings of 3° go round, 3 of them a second time as corners; 45 x 45 translations of 0.2 m.
    assert parts["coarse"] == pytest.approx(math.log(123 * 45**2), abs=0.01)
    assert parts["true_mass"] == pytest.approx(0.5, abs=1e-6)


def test_a_second_peak_that_is_as_good_costs_the_logarithm_of_two():
    matcher, batch = wall_matcher(), batch_of(1)
    with torch.no_grad():
        matcher.coarse_log_scale.fill_(-30.0)
        matcher.fine_log_scale.fill_(-30.0)
        fine = [
            matcher_loss(matcher, batch["cells"], batch["theta"], LossSampling(candidates=n))[1]["fine"]
            for n in (1, 2)
        ]
    assert fine[1] - fine[0] == pytest.approx(math.log(2.0), abs=1e-4)


def test_a_frame_error_beyond_the_loss_is_refused():
    batch = batch_of(1)
    with pytest.raises(ConfigError, match=r"longer than 4\.4 m"):
        loss_of(Matcher(SMALL), {**batch, "theta": batch["theta"] + 5.0})


def test_sight_tells_features_about_the_map_of_the_robot_that_sees():
    matcher, batch = Matcher(SMALL), batch_of(1)
    hidden = matcher.features(batch["cells"])
    first_sees = torch.zeros_like(batch["sight"])
    first_sees[:, 0, 90:94, 90:94] = OPEN_CELL
    seen = matcher.features(batch["cells"], first_sees)
    changed = (seen.coarse_BMFYX != hidden.coarse_BMFYX).flatten(2).any(2)
    assert changed.tolist() == [[True, False]]


def test_an_estimator_that_shall_not_use_sight_does_not():
    window = window_of(THETA)
    told = replace(window, sight=batch_of(1)["sight"][0].numpy())
    torch.manual_seed(0)
    matcher = Matcher(SMALL).eval()
    both = MatcherEstimator(model=matcher, peaks=1)
    alone = replace(both, uses_sight=False)
    assert alone(told).theta == both(window).theta != both(told).theta


def test_every_weight_is_trained():
    torch.manual_seed(0)
    matcher = Matcher(SMALL)
    loss_of(matcher, batch_of(2))[0].backward()
    assert [name for name, weight in matcher.named_parameters() if not weight.grad.abs().sum() > 0.0] == []


def test_a_matcher_learns_to_find_theta():
    torch.manual_seed(0)
    matcher = Matcher(SMALL)
    optimiser = torch.optim.AdamW(matcher.parameters(), lr=5e-3)
    batch = batch_of(2, size=96)
    for _ in range(30):
        optimiser.zero_grad()
        loss_of(matcher, batch)[0].backward()
        optimiser.step()
    estimator = MatcherEstimator(model=matcher.eval())
    for cells, theta in zip(batch["cells"].numpy(), batch["theta"].tolist(), strict=True):
        estimate = estimator(MapWindow(cells=cells, cell_m=0.1))
        assert is_near(estimate.theta, SE2.from_array(theta), within_m=0.1, within_deg=1.0)


def test_a_config_goes_through_plain_values():
    assert MatcherConfig.from_dict(SMALL.as_dict()) == SMALL
    with pytest.raises(ConfigError, match="MatcherConfig: depth is 3; must be one of cell_m, "):
        MatcherConfig.from_dict({**SMALL.as_dict(), "depth": 3})


def test_a_config_that_makes_no_sense_is_refused():
    with pytest.raises(ConfigError, match="fine_factor is 3"):
        MatcherConfig(fine_factor=3)
    with pytest.raises(ConfigError, match="divide the circle"):
        MatcherConfig(heading_step_rad=0.05)


def test_windows_of_other_cells_are_refused():
    with pytest.raises(ConfigError, match=r"cells of 0\.1 m; this one takes cells of 0\.05 m"):
        MatcherEstimator(model=Matcher(MatcherConfig()))(window_of(THETA))


def test_the_loss_of_fresh_weights_is_what_it_was():
    torch.manual_seed(0)
    _, parts = loss_of(Matcher(SMALL), batch_of(2))
    assert parts == pytest.approx({"coarse": 8.95888, "fine": 9.92656, "true_mass": 0.53442}, rel=1e-4)
