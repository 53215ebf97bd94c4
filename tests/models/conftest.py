"""Tests of networks use one thread: threads that wait for each other crawl where something else runs."""

from __future__ import annotations

import pytest
import torch


@pytest.fixture(autouse=True, scope="session")
def _one_thread():
    torch.set_num_threads(1)
