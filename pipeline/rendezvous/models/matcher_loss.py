"""The matcher's loss: cross-entropy of its volumes of scores against the true frame error.

Neither volume is evaluated everywhere. Headings are dense around the truth and sparse elsewhere, each
weighted by the width it stands for, so that the sum over them still estimates the sum over all. They cover
the whole circle: one matcher serves every search.

Legend: B pair, L layer (cells, then sight), H heading, K candidate (the truth first), Y X rows and columns of
a volume of translations.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional

from rendezvous.errors import ConfigError
from rendezvous.models.matcher import Features, Matcher


@dataclass(frozen=True, slots=True, kw_only=True)
class LossSampling:
    """Where the loss evaluates scores."""

    # Share of pairs whose map 1, and θ with it, is turned by one to three more quarters; otherwise scores
    # would be sharp only at the headings that the samples are drawn from.
    turned_share: float = 0.5
    xy_m: float = 4.4  # half width of the coarse volume; no true translation may be longer along an axis
    near_steps: int = 2  # number of coarse headings on either side of the truth
    far_headings: int = 8  # number of headings in the rest of the circle, one in each equal part of it
    candidates: int = 2  # number of close looks: at the truth, and at the highest peaks elsewhere
    # apart_m, apart_rad: distance of another peak from the truth and from the others.
    apart_m: float = 0.6
    apart_rad: float = math.radians(9.0)
    # fine_step_m, fine_steps: translations of a close look, on either side of its centre.
    fine_step_m: float = 0.015
    fine_steps: int = 18
    # Its headings, relative to its centre.
    fine_offsets_rad: tuple[float, ...] = tuple(
        math.radians(d) for d in (-2.4, -1.2, -0.5, 0.0, 0.5, 1.2, 2.4)
    )
    # off_centre_m, off_centre_rad: largest distance of the truth from the centre of its own close look.
    off_centre_m: float = 0.2
    off_centre_rad: float = math.radians(0.25)


@dataclass(frozen=True, slots=True, kw_only=True)
class Volume:
    """Scores of some θ of each pair, each on its own axes."""

    scores_BHYX: Tensor
    heading_BH_rad: Tensor
    y_BY_m: Tensor
    x_BX_m: Tensor


def matcher_loss(
    model: Matcher,
    cells_BMNN: Tensor,
    theta_B3: Tensor,
    sampling: LossSampling,
    *,
    sight_BMNN: Tensor | None = None,
) -> tuple[Tensor, dict[str, float]]:
    """The loss, and its parts.

    Cells and sight are as `Matcher.features` takes them, θ the true frame errors: x [m], y [m], yaw [rad].

    Raises:
        ConfigError: a θ lies outside the scored volume.
    """
    if float(theta_B3[:, :2].abs().amax()) > sampling.xy_m:
        raise ConfigError(
            f"matcher: a frame error is longer than {sampling.xy_m} m, as far as its loss looks"
        )
    # Drawn from the batch itself, so that a run that is resumed goes on as it would have.
    draw = torch.Generator().manual_seed(int(theta_B3.detach().cpu().view(torch.int32).sum()))
    sight_BMNN = torch.zeros_like(cells_BMNN) if sight_BMNN is None else sight_BMNN
    layers_BLMNN = torch.stack([cells_BMNN, sight_BMNN], 1)
    layers_BLMNN, theta_B3 = _quarter_turned(layers_BLMNN, theta_B3, sampling.turned_share, draw)
    features = model.features(layers_BLMNN[:, 0], layers_BLMNN[:, 1])
    with torch.autocast(theta_B3.device.type, enabled=False):
        coarse, log_width_H = _coarse_volume(model, features, theta_B3, sampling, draw)
        sigmas = (0.6 * model.config.heading_step_rad, 0.6 * model.config.coarse_cell_m)
        coarse_loss = _cross_entropy(coarse, theta_B3, log_width_H, sigmas).mean()
        centre_BK3 = _candidates(coarse, theta_B3, sampling, draw)
        fine_loss, mass = _fine_loss(model, features, coarse, centre_BK3, theta_B3, sampling)
    loss = coarse_loss + fine_loss
    parts = {"coarse": coarse_loss, "fine": fine_loss, "true_mass": mass}
    return loss, {name: float(part.detach()) for name, part in parts.items()}


def _quarter_turned(
    layers_BLMNN: Tensor, theta_B3: Tensor, share: float, draw: torch.Generator
) -> tuple[Tensor, Tensor]:
    """Map 1 of some pairs turned about the window's centre, which loses no cell, and the resulting θ."""
    B = len(theta_B3)
    quarters_B = torch.randint(1, 4, (B,), generator=draw) * (torch.rand(B, generator=draw) < share)
    # Rows grow with y, so this way round is the positive one.
    turned = [
        torch.rot90(layers[:, 1], -int(k), (1, 2)) for layers, k in zip(layers_BLMNN, quarters_B, strict=True)
    ]
    angle_B = (quarters_B * (math.pi / 2.0)).to(theta_B3)
    c, s, (x, y, yaw) = angle_B.cos(), angle_B.sin(), theta_B3.unbind(1)
    theta = torch.stack([c * x - s * y, s * x + c * y, yaw + angle_B], 1)
    return torch.stack([layers_BLMNN[:, :, 0], torch.stack(turned)], 2), theta


def _coarse_volume(
    model: Matcher, features: Features, theta_B3: Tensor, sampling: LossSampling, draw: torch.Generator
) -> tuple[Volume, Tensor]:
    """The coarse volume at some headings, and the log of the number of steps that each heading stands for."""
    step, near, far = model.config.heading_step_rad, sampling.near_steps, sampling.far_headings
    B, device = len(theta_B3), theta_B3.device
    jitter = torch.rand(B, 4 + far, generator=draw).to(device)
    around = torch.arange(-near, near + 1, device=device) + jitter[:, :1] - 0.5
    # Rooms have right angles: where the maps are turned by one is where they are most easily mistaken.
    corners = math.pi / 2.0 * torch.arange(1, 4, device=device) + step * (jitter[:, 1:4] - 0.5)
    width = (2.0 * math.pi - (2 * near + 1) * step) / far
    others = (near + 0.5) * step + width * (torch.arange(far, device=device) + jitter[:, 4:])
    heading = theta_B3[:, 2:] + torch.cat([step * around, corners, others], 1)
    log_width_H = torch.zeros(heading.shape[1], device=device)
    log_width_H[-far:] = math.log(width / step)
    reach = round(sampling.xy_m / model.config.coarse_cell_m)
    slides = torch.arange(-reach, reach + 1, device=device) * model.config.coarse_cell_m
    slides = slides.expand(B, -1)
    scores = model.coarse_scores(features, heading, reach)
    return Volume(scores_BHYX=scores, heading_BH_rad=heading, y_BY_m=slides, x_BX_m=slides), log_width_H


def _candidates(volume: Volume, theta_B3: Tensor, sampling: LossSampling, draw: torch.Generator) -> Tensor:
    """(B, K, 3): near the truth, then at the highest coarse peaks away from it."""
    scores = volume.scores_BHYX.detach().clone()
    reach = torch.tensor([sampling.off_centre_m, sampling.off_centre_m, sampling.off_centre_rad])
    offset = (2.0 * torch.rand(len(theta_B3), 3, generator=draw) - 1.0) * reach
    centres, last = [theta_B3 + offset.to(theta_B3)], theta_B3
    for _ in range(sampling.candidates - 1):
        taken = _within(volume, last[:, None], sampling.apart_rad, sampling.apart_m)[:, 0]
        scores.masked_fill_(taken, -torch.inf)
        h, y, x = torch.unravel_index(scores.flatten(1).argmax(1), scores.shape[1:])
        axes = ((volume.x_BX_m, x), (volume.y_BY_m, y), (volume.heading_BH_rad, h))
        last = torch.cat([axis.gather(1, index[:, None]) for axis, index in axes], 1)
        centres.append(last)
    return torch.stack(centres, 1)


def _fine_loss(
    model: Matcher,
    features: Features,
    coarse: Volume,
    centre_BK3: Tensor,
    theta_B3: Tensor,
    sampling: LossSampling,
) -> tuple[Tensor, Tensor]:
    """Cross-entropy over all candidates' close looks together, and the share of the true one."""
    K = centre_BK3.shape[1]
    offsets = centre_BK3.new_tensor(sampling.fine_offsets_rad)
    H = len(offsets)
    slides = torch.arange(-sampling.fine_steps, sampling.fine_steps + 1).to(centre_BK3) * sampling.fine_step_m
    heading = centre_BK3[..., 2:] + offsets
    x_m, y_m = (centre_BK3[..., axis, None] + slides for axis in (0, 1))
    scores = model.fine_scores(
        features, heading.flatten(1), y_m.repeat_interleave(H, 1), x_m.repeat_interleave(H, 1)
    )
    scores = scores.reshape(-1, K, H, *scores.shape[2:])
    scores = scores + model.carried_weight * carried_scores(coarse, centre_BK3, model)[..., None, None, None]
    # A heading stands for what is nearer to it than to its neighbours; the outermost, for as much beyond.
    middles = 0.5 * (offsets[1:] + offsets[:-1])
    edges = torch.cat([2.0 * offsets[:1] - middles[:1], middles, 2.0 * offsets[-1:] - middles[-1:]])
    log_width_H = edges.diff().log()
    rest = torch.logsumexp((scores[:, 1:] + log_width_H[:, None, None]).flatten(1), 1)
    true = Volume(scores_BHYX=scores[:, 0], heading_BH_rad=heading[:, 0], y_BY_m=y_m[:, 0], x_BX_m=x_m[:, 0])
    sigmas = (math.radians(0.1), 0.35 * sampling.fine_step_m)
    within = _cross_entropy(true, theta_B3, log_width_H, sigmas)
    here = torch.logsumexp((scores[:, 0] + log_width_H[:, None, None]).flatten(1), 1)
    log_mass = here - torch.logaddexp(here, rest)
    return (within - log_mass).mean(), log_mass.exp().mean()


def carried_scores(coarse: Volume, centre_BK3: Tensor, model: Matcher) -> Tensor:
    """(B, K): the highest coarse score within a cell of each centre."""
    config = model.config
    near = _within(coarse, centre_BK3, 1.5 * config.heading_step_rad, 1.5 * config.coarse_cell_m)
    return coarse.scores_BHYX[:, None].masked_fill(~near, -torch.inf).flatten(2).amax(2)


def _cross_entropy(
    volume: Volume, theta_B3: Tensor, log_width_H: Tensor, sigmas: tuple[float, float]
) -> Tensor:
    """(B,) against a narrow Gaussian around the truth; sigmas in heading [rad] and in translation [m]."""
    log_p = functional.log_softmax((volume.scores_BHYX + log_width_H[:, None, None]).flatten(1), 1)
    turn, y, x = _offsets(volume, theta_B3[:, None])
    target = (
        (-0.5 * (turn[:, 0] / sigmas[0]).square() + log_width_H)[:, :, None, None]
        - 0.5 * (y / sigmas[1]).square()[:, 0, None, :, None]
        - 0.5 * (x / sigmas[1]).square()[:, 0, None, None, :]
    )
    return -(functional.softmax(target.flatten(1), 1) * log_p).sum(1)


def _within(volume: Volume, centre_BK3: Tensor, half_rad: float, half_m: float) -> Tensor:
    """(B, K, H, Y, X) bool: the cells in the box around each centre."""
    turn, y, x = _offsets(volume, centre_BK3)
    in_heading, in_y, in_x = turn.abs() < half_rad, y.abs() < half_m, x.abs() < half_m
    return in_heading[..., :, None, None] & in_y[..., None, :, None] & in_x[..., None, None, :]


def _offsets(volume: Volume, centre_BK3: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """(B, K, H), (B, K, Y), (B, K, X): each axis relative to each centre, headings in [-pi, pi)."""
    turn = volume.heading_BH_rad[:, None] - centre_BK3[..., 2:]
    turn = torch.remainder(turn + math.pi, 2.0 * math.pi) - math.pi
    return turn, volume.y_BY_m[:, None] - centre_BK3[..., 1:2], volume.x_BX_m[:, None] - centre_BK3[..., :1]
