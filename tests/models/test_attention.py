import numpy as np
import torch
from rendezvous.models.attention import attention_rollout
from rendezvous.models.frame_error import FrameErrorConfig, FrameErrorViT, build_frame_error
from torch import Tensor

PLACES = 12 * 12


def random_attention(*, layers: int = 3, heads: int = 4, batch: int = 2) -> Tensor:
    """(B, L, h, T, T) whose rows sum to 1."""
    generator = torch.Generator().manual_seed(0)
    return torch.rand(batch, layers, heads, 1 + PLACES, 1 + PLACES, generator=generator).softmax(dim=-1)


def test_rollout_is_the_sum_over_all_paths_through_the_layers() -> None:
    attention_BLhTT = random_attention()
    for found, attention_LhTT in zip(
        attention_rollout(attention_BLhTT), attention_BLhTT.numpy(), strict=True
    ):
        share_T = np.eye(1 + PLACES)[0]
        for layer_hTT in attention_LhTT[::-1]:  # from the class token at the end back to the input
            share_T = 0.5 * share_T + 0.5 * share_T @ layer_hTT.mean(axis=0)
        expected = share_T[1:].reshape(12, 12) / share_T[1:].sum()
        np.testing.assert_allclose(found, expected, rtol=1e-4)


def test_looking_everywhere_alike_rolls_out_flat() -> None:
    attention_BLhTT = torch.full((1, 6, 8, 1 + PLACES, 1 + PLACES), 1.0 / (1 + PLACES))
    torch.testing.assert_close(attention_rollout(attention_BLhTT), torch.full((1, 12, 12), 1.0 / PLACES))


def test_a_look_at_one_place_lights_that_place() -> None:
    attention_BLhTT = torch.eye(1 + PLACES).repeat(1, 2, 1, 1, 1)
    row, col = 3, 7
    attention_BLhTT[0, 1, 0, 0] = torch.nn.functional.one_hot(torch.tensor(1 + 12 * row + col), 1 + PLACES)
    expected = torch.zeros(1, 12, 12)
    expected[0, row, col] = 1.0
    torch.testing.assert_close(attention_rollout(attention_BLhTT), expected)


def test_what_a_place_looks_at_is_passed_on_to_the_class_token() -> None:
    attention_BLhTT = torch.eye(1 + PLACES).repeat(1, 2, 1, 1, 1)
    seen, relay = 1 + 12 * 2 + 5, 1 + 12 * 9 + 1
    attention_BLhTT[0, 0, 0, relay] = torch.nn.functional.one_hot(torch.tensor(seen), 1 + PLACES)
    attention_BLhTT[0, 1, 0, 0] = torch.nn.functional.one_hot(torch.tensor(relay), 1 + PLACES)
    expected = torch.zeros(1, PLACES)
    expected[0, [seen - 1, relay - 1]] = 0.5
    torch.testing.assert_close(attention_rollout(attention_BLhTT), expected.reshape(1, 12, 12))


def test_a_transformer_has_a_rollout_for_every_pair() -> None:
    config = FrameErrorConfig(vit=True, cells=48, cell_m=0.4, width=64, depth=2, heads=4)
    network = build_frame_error(config, generator=torch.Generator().manual_seed(0))
    assert isinstance(network, FrameErrorViT)
    with torch.no_grad():
        _, attention_BLhTT = network.with_attention(torch.randn(3, 2, 48, 48))
    rollout_BHW = attention_rollout(attention_BLhTT)
    assert rollout_BHW.shape == (3, 12, 12)
    assert (rollout_BHW > 0.0).all()
    torch.testing.assert_close(rollout_BHW.sum(dim=(1, 2)), torch.ones(3))
