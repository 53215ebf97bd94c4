"""Which images evaluations measure: those of floor plans that none of the networks knows."""

from __future__ import annotations

import io
from types import SimpleNamespace

import pytest
from rich.console import Console

from rendezvous.commands.evaluate.images import unseen_images
from rendezvous.errors import StoreError


def test_an_image_is_left_out_if_any_network_was_trained_on_its_plan():
    images = [SimpleNamespace(plan_digest=digest) for digest in ("aa11", "bb22", "cc33", "aa44", "dd")]
    pose = {"data": {"plan_digests": ["aa1"]}}
    matcher = {"data": {"plan_digests": ["cc3", "ff"]}}
    told = io.StringIO()
    assert (
        unseen_images(images, [pose, matcher, {}], Console(file=told, width=200)) == images[1::2] + images[4:]
    )
    assert told.getvalue().startswith("evaluate: left out 2 of 5 images, of floor plans")
    assert unseen_images(images, [], Console(file=told)) == images
    with pytest.raises(StoreError, match="trained on the floor plans of all 2 images"):
        unseen_images([images[0], images[2]], [pose, matcher], Console(file=told))
