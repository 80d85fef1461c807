"""Scenario cards: standard encounters of social navigation, one small world each."""

from navrl.worlds.cards.card import Card, CardSet
from navrl.worlds.cards.crossing import BlindCorner, CircularCrossing, Crossing
from navrl.worlds.cards.doorway import NarrowDoorway, ObstructedDoorway
from navrl.worlds.cards.hallway import FrontalApproach, NarrowHallway, Overtaking

__all__ = [
    "BlindCorner",
    "Card",
    "CardSet",
    "CircularCrossing",
    "Crossing",
    "FrontalApproach",
    "NarrowDoorway",
    "NarrowHallway",
    "ObstructedDoorway",
    "Overtaking",
]
