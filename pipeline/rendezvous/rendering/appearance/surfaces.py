"""Makers of seamless textures of surfaces: (S, S, 3) float32, sRGB in [0, 1].

Legend: v grows down, u across, both [px]; a colour is (3,) float32.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from rendezvous.rendering.appearance.colour import BINDINGS, BRICKS, STONES, WOODS, pick_colour
from rendezvous.rendering.appearance.noise import Field, relief, smooth_noise


def _axes(size_px: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """v (S, 1) and u (1, S) [px]."""
    index = np.arange(size_px)
    return index[:, None], index[None, :]


def _grey(value: Field) -> Field:
    return np.repeat(value[..., None], 3, axis=2)


def _grain(rng: np.random.Generator, size_px: int) -> Field:
    """(S, S) about 0: fibres of wood along u, and the broad pattern of its rings."""
    fibres = smooth_noise(rng, size_px, (3.0, 160.0), slope=2.5)
    waves = smooth_noise(rng, size_px, (60.0, 400.0), slope=4.0)
    v, _ = _axes(size_px)
    rings = np.sin(2.0 * np.pi * v * rng.integers(8, 16) / size_px + 2.2 * waves)
    grain: Field = (0.55 * fibres + 0.5 * rings * np.abs(rings)).astype(np.float32)
    return grain


def _pieces_of_wood(
    rng: np.random.Generator, grain: Field, piece: NDArray[np.int64], tilted: NDArray[np.bool_]
) -> Field:
    """(S, S, 3): each piece, by its number (S, S), cut elsewhere from the same wood, across where tilted."""
    size_px = len(piece)
    v, u = _axes(size_px)
    count = int(piece.max()) + 1
    # Positions of the cuts are uniform, tones normal with 9 %.
    cut = rng.integers(size_px, size=(count, 2))[piece]
    along, across = np.where(tilted, v, u), np.where(tilted, u, v)
    fibre = grain[(across + cut[..., 0]) % size_px, (along + cut[..., 1]) % size_px]
    tone = np.clip(rng.normal(1.0, 0.09, size=count), 0.75, 1.25).astype(np.float32)[piece]
    base = pick_colour(rng, WOODS)
    darker = np.array([0.10, 0.12, 0.13], np.float32) * rng.uniform(0.6, 1.3)
    wood: Field = base * (tone[..., None] - np.float32(0.55) * fibre[..., None] * darker)
    return wood


def _edges_of(piece: NDArray[np.int64]) -> NDArray[np.bool_]:
    """(S, S): pixels whose left or upper neighbour, across the seam too, belongs to another piece."""
    return (piece != np.roll(piece, 1, axis=0)) | (piece != np.roll(piece, 1, axis=1))


def planks(rng: np.random.Generator, size_px: int) -> Field:
    """Boards side by side with joints anywhere; half of the rows have two joints."""
    rows = int(rng.choice([4, 5, 6, 8]))
    v, u = _axes(size_px)
    row = v * rows // size_px
    start = rng.integers(size_px, size=rows)[row]
    joints = rng.choice([1, 2], size=rows)[row]
    piece = row * 2 + ((u + start) % size_px) * joints // size_px
    wood = _pieces_of_wood(rng, _grain(rng, size_px), piece, np.zeros_like(piece, np.bool_))
    return np.where(_edges_of(piece)[..., None], wood * np.float32(rng.uniform(0.4, 0.7)), wood)


def parquet(rng: np.random.Generator, size_px: int) -> Field:
    """Square blocks of parallel strips, turned by 90 degrees from block to block."""
    blocks, strips = int(rng.choice([4, 6])), int(rng.choice([3, 4, 5]))
    v, u = _axes(size_px)
    row, col = v * blocks // size_px, u * blocks // size_px
    tilted = (row + col) % 2 == 1
    strip = np.where(tilted, u, v) * blocks * strips // size_px % strips
    piece = (row * blocks + col) * strips + strip
    wood = _pieces_of_wood(rng, _grain(rng, size_px), piece, tilted)
    return np.where(_edges_of(piece)[..., None], wood * np.float32(0.6), wood)


def plain_wood(rng: np.random.Generator, size_px: int) -> Field:
    """A single board: veneer of furniture."""
    piece = np.zeros((size_px, size_px), np.int64)
    return _pieces_of_wood(rng, _grain(rng, size_px), piece, np.zeros_like(piece, np.bool_))


def _laid(
    rng: np.random.Generator, size_px: int, rows: int, cols: int, joint_px: int, *, running: bool
) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """(S, S) brick or tile of each pixel, and whether it is a joint; running: rows are staggered."""
    v, u = _axes(size_px)
    row = v * rows // size_px
    shift = (row % 2) * (size_px // (2 * cols)) if running else np.zeros_like(row)
    col = (u + shift) % size_px * cols // size_px
    in_row, in_col = v % (size_px / rows), (u + shift) % (size_px / cols)
    return row * cols + col, (in_row < joint_px) | (in_col < joint_px)


def _surface(
    rng: np.random.Generator,
    colour: Field,
    joint: NDArray[np.bool_],
    joint_colour: Field,
    *,
    mottle: float,
    depth: float,
) -> Field:
    """Unevenly coloured tiles or bricks (S, S, 3) with slightly recessed joints."""
    size_px = len(colour)
    cloud = 1.0 + mottle * smooth_noise(rng, size_px, (40.0, 40.0), slope=2.2)[..., None]
    speckle = 1.0 + 0.5 * mottle * smooth_noise(rng, size_px, (2.0, 2.0), slope=1.0)[..., None]
    laid = np.where(joint[..., None], joint_colour * speckle, colour * cloud)
    height = cv2.blur(np.pad((~joint).astype(np.float32), 2, mode="wrap"), (3, 3))[2:-2, 2:-2]
    shaded: Field = (laid * relief(height, depth)[..., None]).astype(np.float32)
    return shaded


def tiles(rng: np.random.Generator, size_px: int) -> Field:
    """Square tiles with grout; a third are laid in two colours."""
    count = int(rng.choice([2, 4, 6]))
    tile, joint = _laid(rng, size_px, count, count, int(rng.integers(3, 7)), running=False)
    tone = rng.normal(1.0, 0.035, size=count**2).astype(np.float32)[tile][..., None]
    first, second = pick_colour(rng, STONES), pick_colour(rng, STONES)
    odd = ((tile // count + tile % count) % 2 == 1)[..., None] & bool(rng.random() < 0.33)
    colour = np.where(odd, second, first) * tone
    grout = np.float32(rng.uniform(0.35, 0.8)) * np.ones(3, np.float32)
    return _surface(rng, colour, joint, grout, mottle=rng.uniform(0.01, 0.05), depth=0.15)


def brick(rng: np.random.Generator, size_px: int) -> Field:
    """Running bond."""
    rows, cols = 8, int(rng.choice([3, 4]))
    brick, joint = _laid(rng, size_px, rows, cols, int(rng.integers(5, 9)), running=True)
    wobble = smooth_noise(rng, size_px, (12.0, 12.0), slope=3.0) > 2.2
    tone = rng.normal(1.0, 0.12, size=rows * cols)[brick][..., None].astype(np.float32)
    mortar = np.float32(rng.uniform(0.5, 0.8)) * np.array([1.0, 0.97, 0.93], np.float32)
    colour = np.clip(pick_colour(rng, BRICKS) * tone, 0.0, 1.0)
    return _surface(rng, colour, joint | wobble, mortar, mottle=0.07, depth=0.3)


def carpet(rng: np.random.Generator, size_px: int) -> Field:
    """Neutral: rows of loops, worn here and there."""
    loops = smooth_noise(rng, size_px, (2.5, 2.5), slope=1.2)
    wear = smooth_noise(rng, size_px, (150.0, 150.0), slope=3.0)
    v, u = _axes(size_px)
    pitch = 2.0 * np.pi * int(rng.choice([64, 86, 102])) / size_px
    rows = np.sin(pitch * v) * np.sin(pitch * u)
    return _grey((0.78 + 0.07 * loops + 0.05 * rows + 0.025 * wear).astype(np.float32))


def fabric(rng: np.random.Generator, size_px: int) -> Field:
    """Neutral: plain weave, threads of uneven brightness."""
    threads = int(rng.choice([64, 96, 128]))
    v, u = _axes(size_px)
    warp, weft = u * threads // size_px, v * threads // size_px
    over = (warp + weft) % 2 == 0
    period = np.pi * threads / size_px
    round_ = np.where(over, np.abs(np.sin(period * u)), np.abs(np.sin(period * v)))
    tone = np.where(over, rng.normal(0.0, 0.035, threads)[warp], rng.normal(0.0, 0.035, threads)[weft])
    fold = 0.03 * smooth_noise(rng, size_px, (120.0, 120.0), slope=3.5)
    return _grey((0.66 + 0.18 * round_ + tone + fold).astype(np.float32))


def concrete(rng: np.random.Generator, size_px: int) -> Field:
    """Neutral: stains, grain, and a few pores."""
    stain = smooth_noise(rng, size_px, (200.0, 200.0), slope=2.4)
    grain = smooth_noise(rng, size_px, (3.0, 3.0), slope=1.5)
    pores = np.clip(smooth_noise(rng, size_px, (7.0, 7.0), slope=4.0) - 2.4, 0.0, 1.0)
    return _grey((0.74 + 0.04 * stain + 0.02 * grain - 0.35 * pores).astype(np.float32))


def plaster(rng: np.random.Generator, size_px: int) -> Field:
    """Neutral: rough render whose grains show by their shading."""
    height = smooth_noise(rng, size_px, (9.0, 9.0), slope=2.6)
    stain = smooth_noise(rng, size_px, (250.0, 250.0), slope=3.0)
    return _grey((0.86 * relief(height, rng.uniform(0.05, 0.12)) + 0.02 * stain).astype(np.float32))


def paint(rng: np.random.Generator, size_px: int) -> Field:
    """Neutral: an almost even painted wall with the roller's faint texture."""
    height = smooth_noise(rng, size_px, (6.0, 4.0), slope=3.0)
    shade = smooth_noise(rng, size_px, (300.0, 300.0), slope=3.5)
    return _grey((0.92 * relief(height, 0.02) + 0.012 * shade).astype(np.float32))


def marble(rng: np.random.Generator, size_px: int) -> Field:
    """Veins along the level lines of warped clouds."""
    cloud = smooth_noise(rng, size_px, (180.0, 180.0), slope=2.6)
    fine = smooth_noise(rng, size_px, (60.0, 60.0), slope=2.4)
    vein = np.exp(-np.abs(cloud + 0.25 * fine) * rng.uniform(9.0, 16.0))
    hairline = 0.5 * np.exp(-np.abs(fine - 0.4 * cloud) * 22.0)
    veins: Field = np.clip(vein + hairline, 0.0, 1.0).astype(np.float32)[..., None]
    ground, dark = pick_colour(rng, STONES), np.float32(rng.uniform(0.45, 0.75))
    return ground * (np.float32(1.0) + np.float32(0.03) * cloud[..., None]) * (1.0 - veins * (1.0 - dark))


def terrazzo(rng: np.random.Generator, size_px: int) -> Field:
    """Chips of three stones in a ground."""
    colour = np.broadcast_to(pick_colour(rng, STONES), (size_px, size_px, 3))
    for _ in range(3):
        chip = smooth_noise(rng, size_px, (rng.uniform(8.0, 16.0),) * 2, slope=4.5) > 1.25
        colour = np.where(chip[..., None], pick_colour(rng, STONES), colour)
    return colour * (1.0 + 0.012 * smooth_noise(rng, size_px, (2.0, 2.0)))[..., None]


def cardboard(rng: np.random.Generator, size_px: int) -> Field:
    """Brown board: fibres, the flutes underneath, a strip of tape."""
    v, u = _axes(size_px)
    fibre = smooth_noise(rng, size_px, (3.0, 12.0), slope=1.8)
    dirt = smooth_noise(rng, size_px, (150.0, 150.0), slope=2.5)
    flutes = np.sin(2.0 * np.pi * 64.0 * u / size_px)
    brown = np.array([0.70, 0.55, 0.39], np.float32) * np.float32(rng.uniform(0.85, 1.1))
    board: Field = brown * (1.0 + 0.035 * fibre + 0.02 * flutes + 0.03 * dirt).astype(np.float32)[..., None]
    tape = np.abs(v - size_px // 2) < size_px // 24
    return np.where(tape[..., None], 0.55 * board + np.array([0.33, 0.26, 0.17], np.float32), board)


def stripes(rng: np.random.Generator, size_px: int) -> Field:
    """Wallpaper: upright stripes of two colours and a thin third."""
    count = int(rng.choice([4, 6, 8, 12]))
    _, u = _axes(size_px)
    phase = np.broadcast_to((u * count / size_px) % 1.0, (size_px, size_px))[..., None]
    ground = np.float32(0.25) * pick_colour(rng, STONES) + np.float32(0.68)
    other = ground * rng.uniform(0.75, 0.95, size=3).astype(np.float32)
    share = rng.uniform(0.3, 0.6)
    striped = np.where(phase < share, other, ground)
    striped = np.where(np.abs(phase - share - 0.08) < 0.015, 0.7 * other, striped)
    return striped * (1.0 + 0.015 * smooth_noise(rng, size_px, (5.0, 5.0)))[..., None]


def ornament(rng: np.random.Generator, size_px: int) -> Field:
    """Rugs and old wallpaper: a figure in four colours, mirrored both ways and repeated."""
    half = size_px // 8
    figure = smooth_noise(rng, half, (half / 2.5, half / 2.5), slope=4.0)
    figure = np.block([[figure, figure[:, ::-1]], [figure[::-1], figure[::-1, ::-1]]])
    level = np.digitize(np.tile(figure, (4, 4)), [-0.8, -0.2, 0.5])
    # Each is mixed with one ground colour, so that the four match.
    ground = pick_colour(rng, STONES + BRICKS)
    colours = np.stack([0.5 * ground + 0.5 * pick_colour(rng, BINDINGS) for _ in range(4)])
    pile = 1.0 + 0.05 * smooth_noise(rng, size_px, (2.0, 2.0), slope=1.0)
    return colours[level] * pile[..., None]


def brushed(rng: np.random.Generator, size_px: int) -> Field:
    """Neutral: metal brushed along u."""
    lines = smooth_noise(rng, size_px, (1.5, 220.0), slope=2.0)
    return _grey((0.85 + 0.045 * lines).astype(np.float32))


def books(rng: np.random.Generator, size_px: int) -> Field:
    """The front of a filled shelf: four boards, books of all colours and heights, gaps in shadow."""
    board_px, row_px = size_px // 42, size_px // 4
    image = np.full((size_px, size_px, 3), 0.06, np.float32)
    wood = pick_colour(rng, WOODS)
    for top in range(0, 4 * row_px, row_px):
        image[top : top + board_px] = wood
        row = image[top + board_px : top + row_px]
        u = 0
        while u < size_px:
            wide = int(rng.integers(size_px // 64, size_px // 20))
            if rng.random() > 0.12:
                spine = _spine(rng, int(rng.uniform(0.62, 0.93) * len(row)), wide)
                row[-len(spine) :, u : u + wide] = spine[:, : size_px - u]
            u += wide
        row[:] = np.roll(row, rng.integers(size_px), axis=1)
    return image


def _spine(rng: np.random.Generator, high_px: int, wide_px: int) -> Field:
    """A book's round back with a lighter label."""
    round_ = 0.75 + 0.25 * np.sin(np.linspace(0.2, np.pi - 0.2, wide_px, dtype=np.float32))
    spine: Field = np.tile(pick_colour(rng, BINDINGS) * round_[None, :, None], (high_px, 1, 1)).astype(
        np.float32
    )
    label = int(high_px * rng.uniform(0.1, 0.3))
    spine[label : label + high_px // 6, wide_px // 4 : -wide_px // 4] *= np.float32(1.5)
    return spine
