"""Which furniture belongs in which room."""

from __future__ import annotations

from dataclasses import dataclass

from rendezvous.floorplan import catalogue as c
from rendezvous.floorplan.catalogue import Maker


@dataclass(frozen=True, slots=True, kw_only=True)
class Recipe:
    """How rooms of a category are furnished.

    Attributes:
        fill: share of the floor that furniture takes at density 1.
        first: pieces typical of the room, tried in this order.
        then: further pieces, drawn uniformly.
    """

    fill: float
    first: tuple[Maker, ...]
    then: tuple[Maker, ...]


CLUTTER = (c.boxes, c.plant, c.pole, c.bin_, c.single_chair)

RECIPES = {
    "Bedroom": Recipe(
        fill=0.34, first=(c.bed, c.wardrobe, c.desk), then=(c.drawers, c.shelf, c.armchair, *CLUTTER)
    ),
    "Living_Room": Recipe(
        fill=0.26,
        first=(c.sofa, c.coffee_table, c.dining_table, c.shelf),
        then=(c.sofa, c.armchair, c.shelf, c.drawers, c.radiator, *CLUTTER),
    ),
    "Dining_Room": Recipe(
        fill=0.3, first=(c.dining_table, c.drawers), then=(c.shelf, c.armchair, c.radiator, *CLUTTER)
    ),
    "Kitchen": Recipe(
        fill=0.32, first=(c.counter, c.appliance, c.round_table), then=(c.counter, c.drawers, *CLUTTER)
    ),
    "Bathroom": Recipe(
        fill=0.32, first=(c.bathtub, c.toilet, c.washbasin), then=(c.drawers, c.bin_, c.radiator)
    ),
    "Toilet": Recipe(fill=0.2, first=(c.toilet, c.washbasin), then=(c.bin_, c.radiator)),
    "Office": Recipe(
        fill=0.3,
        first=(c.desk, c.shelf, c.desk),
        then=(c.desk, c.desk, c.drawers, c.rack, c.screen, *CLUTTER),
    ),
    "Meeting_Room": Recipe(
        fill=0.28, first=(c.meeting_table,), then=(c.drawers, c.shelf, c.screen, c.radiator, *CLUTTER)
    ),
    "Storage": Recipe(fill=0.3, first=(c.rack, c.shelf), then=(c.rack, c.boxes, c.boxes, c.shelf, *CLUTTER)),
    "Corridor": Recipe(fill=0.06, first=(), then=(c.bench, c.radiator, c.drawers, c.plant, c.bin_, c.boxes)),
    "Hall": Recipe(
        fill=0.14,
        first=(),
        then=(c.round_table, c.meeting_table, c.bench, c.sofa, c.rack, c.screen, c.desk, c.counter, *CLUTTER),
    ),
}
ALIASES = {
    "Child_Room": "Bedroom",
    "Guest_Room": "Bedroom",
    "Lobby": "Hall",
    "Entryway": "Corridor",
    "Hallway": "Corridor",
    "Garage": "Storage",
    "Gym": "Hall",
}
GENERIC = Recipe(
    fill=0.24,
    first=(),
    then=(c.desk, c.sofa, c.dining_table, c.shelf, c.drawers, c.wardrobe, c.armchair, c.rack, *CLUTTER),
)

SMALL_HALL_M2 = 20.0  # a hall under this size is a hallway


def recipe_for(category: str, *, area_m2: float) -> Recipe:
    """The recipe of a HouseExpo category; rooms of unknown use get a mixture."""
    known = ALIASES.get(category, category)
    if known == "Hall" and area_m2 < SMALL_HALL_M2:
        known = "Corridor"
    return RECIPES.get(known, GENERIC)
