"""What is missing is named with what installs it."""

from __future__ import annotations

import pytest

from rendezvous.errors import SetupError, needs_extra


def test_a_missing_package_is_named_with_its_extra():
    said = r"^training needs no_such_package, .*`pip install 'rendezvous-fusion\[learn\]'` installs it$"
    with pytest.raises(SetupError, match=said), needs_extra("learn", "training"):
        import no_such_package  # noqa: F401


def test_a_missing_module_of_our_own_is_a_bug():
    with pytest.raises(ModuleNotFoundError), needs_extra("learn", "training"):
        import rendezvous.no_such_module  # noqa: F401
