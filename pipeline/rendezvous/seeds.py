"""Random streams keyed by their purpose, never by the order in which they are made."""

import hashlib
import json

import numpy as np


def stream(root_seed: int, *key: str | int) -> np.random.Generator:
    """A random stream for one purpose, such as `stream(seed, "explore", plan_id, episode)`.

    Args:
        root_seed: the run's seed; 0 is a seed like any other.
        key: the purpose; equal keys give equal streams in every process, in any order.
    """
    digest = hashlib.sha256(json.dumps([root_seed, *key]).encode()).digest()
    return np.random.Generator(np.random.PCG64(int.from_bytes(digest[:16], "little")))
