"""One renderer for all tests; where its libraries are missing, tests that draw are skipped."""

from __future__ import annotations

import pytest

from rendezvous.errors import SetupError
from rendezvous.rendering.opengl.gl import check_libraries
from rendezvous.rendering.opengl.renderer import Renderer
from tests.rendering.scenes import pool, textures


@pytest.fixture(scope="session")
def renderer() -> Renderer:
    try:
        check_libraries()
    except SetupError as error:
        pytest.skip(str(error))
    return Renderer(pool(), textures())
