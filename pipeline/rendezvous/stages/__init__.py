"""The seven stages: each loads, calls a room, saves.

`rendezvous.config.stage_table` lists them in flow order.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from typing import Any


def stage_function(name: str) -> Callable[..., Any]:
    """The function that runs a stage; its module, and all that it needs, is imported only now."""
    function: Callable[..., Any] = getattr(import_module(f"{__name__}.{name}"), name)
    return function
