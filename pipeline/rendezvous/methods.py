"""The registry of methods: estimators of the frame error, and ways in which a fusion refines T̃ by the maps.

A method of your own takes part in an evaluation without a fork. Name it in any of

- `rendezvous.evaluate(data, methods={"mine": MyEstimator})`,
- `rendezvous evaluate --methods identity,mypackage.module:MyEstimator`,
- an entry point in the group `rendezvous.methods`: `mine = "mypackage.module:MyEstimator"`.

`MyEstimator` is a class or function that returns a `FrameErrorEstimator`: something with a `name` that takes
a `MapWindow` and returns an `Estimate`. If it has a parameter `search`, it is given the `SearchRange` from
which the frame errors are drawn.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from importlib.metadata import entry_points
from typing import Any

from rendezvous.alignment.estimate import FrameErrorEstimator, Identity
from rendezvous.alignment.window import DEFAULT_SEARCH, SearchRange
from rendezvous.baselines.correlative import CorrelativeSearch
from rendezvous.baselines.hough import HoughSpectrum
from rendezvous.baselines.orb import OrbRansac
from rendezvous.errors import ConfigError
from rendezvous.fusion.refinement import FrameErrorPrior, Refiner, correlative_refiner
from rendezvous.models.table_one import ABLATION_ROWS, PRINTED_HOUGH, AblationRow, PrintedErrors

ENTRY_POINTS = "rendezvous.methods"  # the group of entry points by which packages add methods

_OWN_COLOURS = ("#8c6d31", "#5b5f97", "#b5485d", "#3f7d5c", "#a0522d")


@dataclass(frozen=True, slots=True, kw_only=True)
class Method:
    """An estimator of the frame error that can be measured."""

    name: str  # as options, files and `metrics.json` spell it
    title: str  # as tables spell it
    colour: str  # in charts, `#rrggbb`
    # Makes the estimator; None for a network, which is made from its weights.
    factory: Callable[..., FrameErrorEstimator] | None = None
    takes_search: bool = True  # whether the factory has the parameter `search`
    model: str = ""  # whose weights a network needs; '' for a method without weights
    row: AblationRow | None = None  # the row of the paper's ablation that this is
    printed: PrintedErrors | None = None  # errors in the paper; None for a method it does not have
    shipped: bool = True  # False for a method that a user added

    @property
    def needs_weights(self) -> bool:
        """Whether it is a network."""
        return bool(self.model)

    def estimator(self, search: SearchRange) -> FrameErrorEstimator:
        """A method without weights, ready to be called; `search` is where to look for the frame error."""
        assert self.factory is not None, f"{self.name} is made from its weights"
        return self.factory(search=search) if self.takes_search else self.factory()


def _rows() -> list[Method]:
    colours = ("#7ec4c1", "#42a09e", "#9ed6b4", "#1c7474", "#d6b2e0", "#b06cbe", "#e89ec4", "#702c84")
    return [
        Method(name=row.name, title=row.title, colour=colour, model=row.name, row=row, printed=row.printed)
        for row, colour in zip(ABLATION_ROWS, colours, strict=True)
    ]


_SHIPPED = (
    Method(name="identity", title="Identity", colour="#969aa2", factory=Identity, takes_search=False),
    Method(name="hough", title="Hough, in the window", colour="#d68a1c", factory=HoughSpectrum),
    Method(
        name="hough-global",
        title="Hough, global",
        colour="#f0be66",
        factory=HoughSpectrum,
        takes_search=False,
        printed=PRINTED_HOUGH,
    ),
    Method(name="orb", title="ORB + RANSAC", colour="#4a914a", factory=OrbRansac, takes_search=False),
    Method(name="correlative", title="Correlative search", colour="#cb2431", factory=CorrelativeSearch),
    Method(name="matcher-maps", title="Matcher, maps alone", colour="#8cb2e2", model="matcher"),
    Method(name="matcher", title="Learned matcher", colour="#2f6fd0", model="matcher"),
    *_rows(),
)
METHODS: Mapping[str, Method] = {method.name: method for method in _SHIPPED}
"""The shipped methods by name, in the order of tables."""


@cache
def installed_methods() -> Mapping[str, Method]:
    """The shipped methods, then those that installed packages add by entry points, by name.

    Raises:
        ConfigError: a package's entry point has the name of another method, or cannot be imported.
    """
    found = dict(METHODS)
    for entry in sorted(entry_points(group=ENTRY_POINTS), key=lambda entry: entry.name):
        if entry.name in found:
            raise ConfigError(f"entry point {entry.name} = {entry.value}: another method has that name")
        try:
            factory = entry.load()
        except (ImportError, AttributeError) as error:
            raise ConfigError(f"entry point {entry.name} = {entry.value}: {error}") from error
        found[entry.name] = own_method(entry.name, factory, number=len(found) - len(METHODS))
    return found


def method_at(path: str, *, number: int = 0) -> Method:
    """The user's method at `package.module:Class`, named after the class.

    Raises:
        ConfigError: there is no such module or name in it.
    """
    module, _, attribute = path.partition(":")
    try:
        return own_method(attribute, getattr(import_module(module), attribute), number=number)
    except (ImportError, AttributeError, ValueError) as error:
        raise ConfigError(f"--methods {path}: {error}; must be importable as package.module:Class") from error


def own_method(name: str, factory: Any, *, number: int = 0) -> Method:
    """A user's method.

    Args:
        name: must not be that of a shipped method.
        factory: a class or function that returns a `FrameErrorEstimator`.
        number: among the user's methods; its colour follows.

    Raises:
        ConfigError: the name is taken, or the factory cannot be called.
    """
    if name in METHODS:
        raise ConfigError(f"method {name!r} is shipped already; give yours another name")
    if not callable(factory):
        raise ConfigError(
            f"method {name!r}: {factory!r} is not a class or function that returns an estimator"
        )
    if hasattr(factory, "name") and not inspect.isclass(factory):
        raise ConfigError(
            f"method {name!r}: {factory!r} is an estimator; give its class, or a function that returns it"
        )
    parameters = inspect.signature(factory).parameters
    return Method(
        name=name,
        title=name,
        colour=_OWN_COLOURS[number % len(_OWN_COLOURS)],
        factory=factory,
        takes_search="search" in parameters,
        shipped=False,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class RefinementMethod:
    """One way in which a fusion refines T̃ by the maps."""

    name: str  # as options and `metrics.json` spell it
    title: str  # as tables spell it
    refiner: Refiner | None = None  # gives the estimator; None for no refinement, and for the matcher
    needs_matcher: bool = False  # whether it uses the learned matcher's weights
    # Whether it differs from another only by using the relative pose's covariance, which the true relative
    # pose does not have.
    needs_covariance: bool = False


def _hough(prior: FrameErrorPrior | None) -> tuple[FrameErrorEstimator, SearchRange]:
    """Searches the whole default range: Hough has no use for a prior."""
    return HoughSpectrum(search=DEFAULT_SEARCH), DEFAULT_SEARCH


def _orb(prior: FrameErrorPrior | None) -> tuple[FrameErrorEstimator, SearchRange]:
    """Searches wherever features match."""
    return OrbRansac(), DEFAULT_SEARCH


_REFINEMENTS = (
    RefinementMethod(name="none", title="Relative pose only"),
    RefinementMethod(name="hough", title="+ Hough", refiner=_hough),
    RefinementMethod(name="orb", title="+ ORB", refiner=_orb),
    RefinementMethod(name="correlative", title="+ correlative search", refiner=correlative_refiner),
    RefinementMethod(name="learned", title="+ learned matcher", needs_matcher=True),
    RefinementMethod(
        name="auto",
        title="+ learned, told the pose's covariance",
        needs_matcher=True,
        needs_covariance=True,
    ),
)
REFINEMENTS: Mapping[str, RefinementMethod] = {way.name: way for way in _REFINEMENTS}
"""Ways to refine by name, in the order of tables."""
