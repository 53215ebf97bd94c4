"""Blender as a Python package, the optional extra `pathtraced`: whether it is there, and its import."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from importlib.metadata import version
from importlib.util import find_spec
from typing import Any

from rendezvous.errors import needs_extra


def check_blender() -> None:
    """Check that Blender is installed, without the seconds that its import takes.

    Raises:
        SetupError: it is not.
    """
    with needs_extra("pathtraced", "render.engine cycles"):
        if find_spec("bpy") is None:
            raise ModuleNotFoundError(name="bpy")


def cycles_name() -> str:
    """Name of the renderer, with the version of its package."""
    check_blender()
    return f"Cycles (bpy {version('bpy')})"


@cache
def blender() -> Any:
    """Module `bpy` with an empty scene; it has one for each process, which lasts as long.

    Raises:
        SetupError: Blender is not installed.
    """
    check_blender()
    # Its audio, which nothing here uses, is compiled for numpy 1 and says so at length under numpy 2.
    with without_output():
        import bpy
    bpy.ops.wm.read_factory_settings(use_empty=True)
    return bpy


@contextmanager
def without_output() -> Iterator[None]:
    """Silence the process: Blender writes past Python to the file descriptors, a line for each step."""
    sys.stdout.flush()
    sys.stderr.flush()
    kept = [os.dup(descriptor) for descriptor in (1, 2)]
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        for descriptor in (1, 2):
            os.dup2(nowhere, descriptor)
        yield
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        for descriptor, was in zip((1, 2), kept, strict=True):
            os.dup2(was, descriptor)
            os.close(was)
        os.close(nowhere)
