"""Parameters of a street, and named kinds of streets."""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError

_DOMAINS = {
    (0.0, 1.0): "crossroads signals verges parking slanted_parking parked overhead_wires bare_soil boundaries greenery "
                "forest drive_cars hard_cases facades hedges",
    (0.0, 5.0): "buildings trees palms cycas shrubs clutter signs people traffic stations two_wheelers",
    (0.0, 20.0): "gantries lorries", (0.8, 8.0): "verge_width", (0.0, 0.2): "grass_height", (0.0, 1.5): "bends",
    (0.0, 2.0): "slopes", (60.0, 5000.0): "junction_spacing", (2.5, 4.0): "lane_width", (0.5, 8.0): "pavement",
    (1.5, 20.0): "front_yard", (1.5, 12.0): "median", (10.0, 100.0): "lamp_spacing",
}  # fmt: skip
_ZERO = ("junction_spacing", "lane_width", "pavement", "front_yard", "median", "lamp_spacing")  # 0 is allowed too


@dataclass(frozen=True)
class StreetParameters:
    """Parameters of a kind of street; each seed is another street of the kind."""

    junction_spacing: float = 140.0  # Mean distance between junctions, metres; at least 60, or 0 for none
    crossroads: float = 0.4  # Share of junctions with side streets on both sides; the others are T-junctions
    signals: float = 0.4  # Share of junctions with traffic lights; at the others side streets stop or give way
    lanes: int = 0  # Lanes per direction, 1 to 3; 0 draws one or two
    median: float = 0.0  # Width of a planted median, metres, 0 or 1.5 to 12
    verges: float = 0.75  # Probability of a strip of grass or soil between curb and pavement, per side
    verge_width: float = 1.8  # Mean width of that strip, metres, 0.8 to 8
    grass_height: float = 0.07  # Mean height of blades, metres, 0 to 0.2; beams end between them
    bare_soil: float = 0.2  # Share of verges and gardens that are soil rather than grass
    parking: float = 0.65  # Probability of parking bays, per side
    slanted_parking: float = 0.25  # Probability that bays are slanted rather than along the curb
    parked: float = 0.7  # Share of occupied bays
    lamp_spacing: float = 0.0  # Distance between street lamps, metres, 10 to 100; 0 draws 25 to 40
    buildings: float = 1.0  # Probability that a lot is built on; 0 leaves all land open
    boundaries: float = 1.0  # Share of property lines that keep their fence, wall or hedge
    # trees, palms, cycas, shrubs: factor on their numbers; 0 is none, 2 about twice as many
    trees: float = 1.0
    palms: float = 1.0
    cycas: float = 1.0
    shrubs: float = 1.0
    # clutter, signs, people, traffic: factor on bins, benches, bollards and the like; on traffic signs; on people; on
    # moving vehicles
    clutter: float = 1.0
    signs: float = 1.0
    people: float = 1.0
    traffic: float = 1.0
    # stations, gantries: factor on bus stops, one in every second block of 60 m at 1; on gantries over roads with a
    # median, one in every fifth block
    stations: float = 1.0
    gantries: float = 1.0
    lorries: float = 1.0  # Factor on the share of trucks among moving vehicles, 6 % at 1; 0 is none
    # Factor on bicycles and motorcycles, parked and ridden. Values above 1 add some and change nothing else.
    two_wheelers: float = 1.0
    # bends, slopes: factors on the curvature, up to 1.5, and on the grades, up to 2; 0 is straight, or level
    bends: float = 1.0
    slopes: float = 1.0
    lane_width: float = 0.0  # Mean width of a lane, metres, 2.5 to 4; 0 draws 3.1 to 3.6
    pavement: float = 0.0  # Mean width of the pavement, metres, 0.5 to 8; 0 draws 1.9 to 3.8
    # Share of houses with their facade at the pavement, the others have front gardens; -1 draws it per side
    facades: float = -1.0
    storeys: tuple[int, int] = (0, 0)  # Least and greatest number of storeys, 1 to 20; zeros draw 1 to 5
    front_yard: float = 0.0  # Mean depth of front gardens, metres, 1.5 to 20; 0 draws 3.5 to 7.5
    hedges: float = -1.0  # Share of hedges among boundaries, the others are fences and walls; -1 draws it per side
    # Share of property lines that are overgrown, 0 to 1: untrimmed hedges up to 3 m high, shrubs on both sides of
    # fences and walls, low trees that overhang the pavement. 0 leaves clipped hedges.
    greenery: float = 0.0
    forest: float = 0.0  # Density of woods on open land, 0 to 1: undergrowth at the edge, trees behind it
    drive_cars: float = 0.0  # Share of driveways with a car
    overhead_wires: float = 0.7  # Probability of utility poles with wires along the street and to the houses
    # Probability that a plant, a pole or a parked vehicle along the curb gets a neighbour that is hard to separate from
    # it: poles inside crowns, shrubs in a row or around a post, bins against posts, plants that touch parked cars,
    # objects close behind trees. 0 is never; at 1 all do where there is room.
    hard_cases: float = 0.3
    # 0, or the number of another year, up to 999: some objects of the street are gone, moved, leaned, grown or new,
    # and other cars are parked. Every year is a change of year 0.
    year: int = 0

    def __post_init__(self) -> None:
        for (low, high), names in _DOMAINS.items():
            for name in names.split():
                value, zero = getattr(self, name), name in _ZERO
                drawn = (zero and value == 0) or (name in ("facades", "hedges") and value == -1)
                if not (isinstance(value, int | float) and (low <= value <= high or drawn)):
                    either = "0 or " if zero else ""
                    raise ParameterError(f"{name} must be {either}between {low:g} and {high:g}, got {value!r}")
        storeys = tuple(self.storeys) if isinstance(self.storeys, list) else self.storeys
        object.__setattr__(self, "storeys", storeys)
        whole = isinstance(storeys, tuple) and len(storeys) == 2 and all(isinstance(n, int) for n in storeys)
        if not whole or not (storeys == (0, 0) or 1 <= storeys[0] <= storeys[1] <= 20):
            raise ParameterError(f"storeys must be two rising integers from 1 to 20, got {storeys!r}")
        if isinstance(self.year, bool) or not isinstance(self.year, int) or not 0 <= self.year <= 999:
            raise ParameterError(f"year must be an integer from 0 to 999, got {self.year!r}")
        if self.lanes not in (0, 1, 2, 3):
            raise ParameterError(f"lanes must be 0, 1, 2 or 3, got {self.lanes!r}")


STREETS: dict[str, StreetParameters] = {
    "town": StreetParameters(),
    "suburb": StreetParameters(
        junction_spacing=180.0, signals=0.1, lanes=1, verges=1.0, verge_width=2.4, parking=0.4, parked=0.45,
        buildings=0.8, clutter=0.6, shrubs=1.5, people=0.6, traffic=0.6, overhead_wires=1.0,
    ),
    "ring_road": StreetParameters(
        junction_spacing=300.0, crossroads=0.2, signals=0.5, lanes=2, median=5.0, verges=1.0, verge_width=5.0,
        lamp_spacing=30.0, grass_height=0.09, bare_soil=0.05, parking=0.0, buildings=0.15, trees=0.0, palms=0.5,
        cycas=5.0, shrubs=1.4, clutter=0.3, signs=0.6, people=0.3, traffic=0.5, overhead_wires=0.0,
    ),
    "campus": StreetParameters(
        verges=0.9, verge_width=3.0, palms=0.0, cycas=0.0, trees=2.0, overhead_wires=1.0,
    ),
    "old_town": StreetParameters(
        junction_spacing=90.0, signals=0.2, lanes=1, lane_width=2.7, pavement=1.5, verges=0.05, parking=0.8,
        slanted_parking=0.05, parked=0.92, facades=0.95, storeys=(3, 5), trees=0.3, palms=0.0, cycas=0.0, shrubs=0.4,
        clutter=1.5, people=2.0, traffic=0.6, two_wheelers=2.0, overhead_wires=0.1, greenery=0.2,
    ),
    "downtown": StreetParameters(
        junction_spacing=110.0, crossroads=0.9, signals=0.9, lanes=2, pavement=4.0, verges=0.15, parking=0.7,
        slanted_parking=0.1, parked=0.85, facades=1.0, storeys=(3, 14), trees=0.6, palms=0.0, cycas=0.0, shrubs=0.3,
        clutter=2.0, signs=1.5, people=3.0, traffic=2.0, lorries=1.5, stations=1.5, overhead_wires=0.05,
    ),
    "american_suburb": StreetParameters(
        junction_spacing=160.0, signals=0.05, lanes=1, lane_width=3.7, pavement=1.5, verges=1.0, verge_width=2.2,
        parking=0.35, slanted_parking=0.0, parked=0.35, facades=0.0, storeys=(1, 2), front_yard=8.0, boundaries=0.15,
        bare_soil=0.08, trees=1.8, palms=0.1, cycas=0.0, shrubs=1.5, clutter=0.7, people=0.5, traffic=0.5,
        overhead_wires=1.0, greenery=0.25, drive_cars=0.7,
    ),
    "residential": StreetParameters(
        junction_spacing=110.0, signals=0.05, lanes=1, lane_width=2.8, pavement=1.6, verges=0.15, parking=0.85,
        slanted_parking=0.0, parked=0.75, facades=0.2, storeys=(2, 3), front_yard=4.0, boundaries=0.92, hedges=0.55,
        trees=0.8, palms=0.0, cycas=0.0, shrubs=1.5, clutter=0.7, people=0.8, traffic=0.5, two_wheelers=1.5,
        overhead_wires=0.05, greenery=0.75, drive_cars=0.4,
    ),
    "industrial": StreetParameters(
        junction_spacing=180.0, signals=0.3, lanes=1, lane_width=3.7, pavement=1.8, verges=0.7, verge_width=2.5,
        parking=0.6, parked=0.6, buildings=0.55, facades=0.05, storeys=(1, 3), front_yard=12.0, boundaries=0.95,
        hedges=0.15, trees=0.4, palms=0.0, cycas=0.0, clutter=0.7, people=0.25, traffic=1.2, lorries=8.0,
        overhead_wires=0.5, greenery=0.2, forest=0.15, drive_cars=0.6,
    ),
    "rural": StreetParameters(
        junction_spacing=400.0, crossroads=0.2, signals=0.0, lanes=1, lane_width=3.0, pavement=0.6, verges=1.0,
        verge_width=2.4, grass_height=0.18, parking=0.0, lamp_spacing=90.0, buildings=0.08, boundaries=0.12,
        hedges=0.6, trees=0.8, palms=0.0, cycas=0.0, shrubs=2.0, clutter=0.1, signs=0.6, people=0.1, traffic=0.5,
        stations=0.3, overhead_wires=0.7, greenery=0.7, forest=0.8,
    ),
    "asian_arterial": StreetParameters(
        junction_spacing=200.0, crossroads=0.7, signals=0.9, lanes=3, median=3.0, pavement=3.5, verges=0.8,
        verge_width=1.8, parking=0.15, facades=0.8, storeys=(3, 12), trees=1.3, palms=0.4, cycas=0.6, shrubs=1.5,
        clutter=1.2, signs=1.5, people=2.0, traffic=2.0, lorries=1.5, gantries=2.0, two_wheelers=5.0,
        overhead_wires=0.5, hard_cases=0.5,
    ),
}  # fmt: skip
"""Named kinds.

``town``, ``suburb``, ``campus`` with trees, ``ring_road`` like luo2016's in Xiamen, ``old_town`` (narrow, facades at
the pavement, parked cars), ``downtown`` (four lanes, tall buildings), ``american_suburb`` (lawns, driveways, wires),
``residential`` (as in KITTI: hedges, low walls, cars along both curbs, overgrown front gardens), ``industrial``,
``rural`` (between woods) and ``asian_arterial``.
"""


def street_parameters(config: object) -> StreetParameters:
    """Return the street parameters that a configuration describes."""
    if isinstance(config, StreetParameters):
        return config
    if not isinstance(config, (str, Mapping)):
        raise ParameterError(f"a street is the name of a kind or a mapping of parameters, got {config!r}")
    changes: dict[str, Any] = {"kind": config} if isinstance(config, str) else dict(config)
    kind = changes.pop("kind", "town")
    if kind not in STREETS:
        raise ParameterError(f"kind of street {kind!r} is unknown (kinds: {', '.join(STREETS)})")
    known = [field.name for field in fields(StreetParameters)]
    unknown = sorted(set(changes) - set(known))
    if unknown:
        raise ParameterError(f"unknown street parameters: {', '.join(unknown)} (known: {', '.join(known)})")
    return StreetParameters(**{**{name: getattr(STREETS[kind], name) for name in known}, **changes})
