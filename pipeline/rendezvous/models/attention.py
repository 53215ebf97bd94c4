"""Attention Rollout: what the class token's answer looks at (Abnar & Zuidema, 2020).

Legend: B sample, L layer, h head, T token (the class token first), H W places.
"""

from __future__ import annotations

import torch
from torch import Tensor


def attention_rollout(attention_BLhTT: Tensor) -> Tensor:
    """(B, H, W) share of each place in the class token's last features; the places of a sample sum to 1.

    Attention is averaged over heads and mixed half and half with the identity, for the residual connection,
    then multiplied through the layers from the first to the last. What the class token keeps of itself is
    left out.

    Args:
        attention_BLhTT: as `FrameErrorViT.with_attention` gives it: rows are the tokens that look, and T is
            one more than a square.
    """
    heads_BLTT = attention_BLhTT.float().mean(dim=2)
    tokens = heads_BLTT.shape[-1]
    mixed_BLTT = 0.5 * (heads_BLTT + torch.eye(tokens, device=heads_BLTT.device))
    rollout_BTT = mixed_BLTT[:, 0]
    for layer in range(1, mixed_BLTT.shape[1]):
        rollout_BTT = mixed_BLTT[:, layer] @ rollout_BTT
    places_BP = rollout_BTT[:, 0, 1:]
    side = round((tokens - 1) ** 0.5)
    return (places_BP / places_BP.sum(dim=-1, keepdim=True)).reshape(-1, side, side)
