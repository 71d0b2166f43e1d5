"""Parameters of a simulated survey, presets, and many surveys drawn from one description."""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from numbers import Integral, Real
from typing import Any

import numpy as np
import pyproj

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.core.validation import check_positive
from mlsroad_pipeline.simulation.parameters.devices import Device, ScannerSystem, Variation, variation
from mlsroad_pipeline.simulation.parameters.known_scanners import SCANNERS, scanner_system
from mlsroad_pipeline.simulation.parameters.street_parameters import STREETS, StreetParameters, street_parameters

LAYOUT = ("piece_length", "frames", "scan_spacing", "range_image")
"""Keys of a survey's configuration that describe its file layout."""

OF_THE_SCANNER = ("profile_rate", "pulse_rate", "range_noise", "beam_divergence", "max_range")
"""Parameters whose value None stands for the scanner's own."""

_ORIGIN = ("easting", "northing", "height")
_KEYS = ("count", "presets", "streets", "variety", "factors", "seed")
_FACTORS = ("trees", "shrubs", "clutter", "signs", "people", "traffic", "two_wheelers", "lorries")
_SHARES = ("parking", "parked", "verges", "boundaries", "greenery", "hard_cases", "bare_soil", "drive_cars")
# Shares, at a variety of 1, of heads that see a sector only and of those without upper beams.
_NARROW, _CUT = 0.25, 0.25
_DOMAINS: tuple[tuple[str, float, float, str], ...] = (
    ("length", 10, 5000, " m"), ("range_noise", 0, 100, ""), ("trajectory_noise", 0, 100, ""),
    ("boresight_error", 0, 10, " degrees"), ("pass_offset", 0, 100, " m"), ("wetness", 0, 1, ""),
    ("image_readout", 0, 1, " s"), ("beam_rays", 1, 9, ""), ("passes", 1, 8, ""), ("first_pass", 0, 200, ""),
    ("revolutions", 1, 100, ""),
    ("image_width", 16, 8192, " pixels"), ("image_height", 16, 8192, " pixels"),
    ("easting", -1e8, 1e8, " m"), ("northing", -1e8, 1e8, " m"), ("height", -500, 9000, " m"),
    ("start_time", 0, 1e10, " s"),
)  # fmt: skip


@dataclass(frozen=True)
class SimulationParameters:
    """Parameters of a simulated survey.

    Parameters
    ----------
    seed : int, default 0
        Non-negative. It determines the street, all objects and all noise.
    length : float, default 150
        Surveyed length along the street, metres, 10 to 5000; the street continues at both ends.
    speed : float, default 10
        Mean speed of the van, m/s. Lower speeds are denser along the street.
    scanner : ScannerSystem, default the RIEGL VMX-450
        Scanners and their mounting; see `SCANNERS`.
    profile_rate : float or None, default 200
        Revolutions per second of each scanner. None, here and for the next four, is the scanner's own value.
    pulse_rate : float or None, default 180000
        Pulses per second of each scanner; about two thirds of them return. The VMX-450 reaches 550000.
    range_noise : float or None, default 0.005
        Standard deviation of a strong return's range, metres; weak returns are noisier.
    beam_divergence : float or None, default 0.0003
        Full angle of the beam, radians. Larger mixes more pixels at edges.
    max_range : float or None, default 120
        Longest recorded range, metres.
    beam_rays : int, default 5
        Rays that sample the beam near edges, 1 to 9; more resolve foliage better and take longer.
    wetness : float, default 0.03
        Share of paved ground under a film of water, 0 to 1: dark, and a mirror at grazing incidence.
    trajectory_noise : float, default 1.0
        Factor on the errors of the reported trajectory, which are about 1 cm and 0.005 degrees at 1; 0 is none.
    boresight_error : float, default 0.003
        Standard deviation of the error of each mounting angle of a scanner, degrees; the same number in metres is that
        of its lever arm.
    scan_spacing : float or None, default None
        Street between single scans, metres: only pulses of the first `revolutions` of the first scanner after each such
        distance are sent. None scans all the time.
    revolutions : int, default 1
        Number of revolutions in a scan, 1 to 100.
    passes : int, default 1
        Number of passes through the street, 1 to 8; each has its own track, traffic and errors.
    first_pass : int, default 0
        Number of the first pass, 0 to 200: a survey that begins with another one is another recording of the street.
    pass_offset : float, default 0.03
        Constant offset of the reported positions of each further pass, metres.
    with_images : bool, default True
        Whether three cameras take images that colour the points. Without images points have the colours of the
        surfaces in the sun, without cast shadows.
    image_width, image_height : int, default 640, 480
        Size of the images, pixels.
    image_interval : float, default 8
        Distance between images of one camera, metres.
    image_readout : float, default 0.004
        Time between the exposures of the first and the last row of an image, seconds; 0 is a global shutter.
    easting, northing, height : float, default 389300, 5819700, 34
        World coordinates of the start of the street, metres.
    epsg : int, default 25833
        Projected coordinate reference system in metres.
    start_time : float, default 216000
        GPS seconds of the week at the start of the drive.
    street : StreetParameters
        Parameters of the street; see `STREETS`.

    Raises
    ------
    ParameterError
        If a value is outside its domain, or if `epsg` is not a projected system in metres.
    """

    seed: int = 0
    length: float = 150.0
    speed: float = 10.0
    scanner: ScannerSystem = SCANNERS["vmx450"]
    profile_rate: float | None = 200.0
    pulse_rate: float | None = 180_000.0
    range_noise: float | None = 0.005
    beam_divergence: float | None = 0.0003
    max_range: float | None = 120.0
    beam_rays: int = 5
    wetness: float = 0.03
    trajectory_noise: float = 1.0
    boresight_error: float = 0.003
    scan_spacing: float | None = None
    revolutions: int = 1
    passes: int = 1
    first_pass: int = 0
    pass_offset: float = 0.03
    with_images: bool = True
    image_width: int = 640
    image_height: int = 480
    image_interval: float = 8.0
    image_readout: float = 0.004
    easting: float = 389_300.0
    northing: float = 5_819_700.0
    height: float = 34.0
    epsg: int = 25833
    start_time: float = 216_000.0
    street: StreetParameters = field(default_factory=StreetParameters)

    def __post_init__(self) -> None:
        if isinstance(self.seed, bool) or not isinstance(self.seed, Integral) or self.seed < 0:
            raise ParameterError(f"seed must be an integer >= 0, got {self.seed!r}")
        for name in ("speed", "image_interval"):
            check_positive(getattr(self, name), name)
        if self.scan_spacing is not None:
            check_positive(self.scan_spacing, "scan_spacing")
        for name in OF_THE_SCANNER:
            if name != "range_noise" and getattr(self, name) is not None:
                check_positive(getattr(self, name), name)
        for name, low, high, unit in _DOMAINS:
            value = getattr(self, name)
            if value is not None and not (isinstance(value, Real) and low <= value <= high):
                raise ParameterError(f"{name} must be between {low:g} and {high:g}{unit}, got {value!r}")
        for name in ("beam_rays", "passes", "first_pass", "revolutions"):
            if getattr(self, name) != int(getattr(self, name)):
                raise ParameterError(f"{name} must be an integer, got {getattr(self, name)!r}")
        _ = self.devices  # checks that its fields agree
        self.crs_wkt()

    @property
    def devices(self) -> tuple[Device, ...]:
        """The scanners with the rates, noise, divergence and range of these parameters."""
        changed = self.scanner.changed(
            profile_rate=self.profile_rate, pulse_rate=self.pulse_rate, range_noise=self.range_noise,
            divergence=self.beam_divergence, max_range=self.max_range,
        )  # fmt: skip
        return changed.devices

    def crs_wkt(self) -> str:
        """Return the reference system as WKT 2; raises ParameterError if it is not a projected system in metres."""
        try:
            crs = pyproj.CRS.from_epsg(self.epsg)
        except pyproj.exceptions.CRSError as error:
            raise ParameterError(f"epsg {self.epsg!r} is not a known coordinate reference system") from error
        if not crs.is_projected or crs.axis_info[0].unit_name != "metre":
            raise ParameterError(f"epsg {self.epsg!r} must be a projected system in metres, is {crs.name!r}")
        return str(crs.to_wkt())


_DEMO = SimulationParameters()
_OWN: dict[str, Any] = dict.fromkeys(OF_THE_SCANNER)
_ROTATING = (
    "hdl64", "hdl32", "vlp32", "vlp32_front", "vlp16", "pandar64", "pandaset", "hesai_xt32", "os1_64", "os1_128",
)  # fmt: skip

PRESETS: dict[str, SimulationParameters] = {
    "tiny": replace(_DEMO, length=30.0, speed=14.0, profile_rate=50.0, pulse_rate=14_000.0, image_interval=15.0,
                    image_width=240, image_height=180),
    "small": replace(_DEMO, length=80.0, speed=10.0, profile_rate=100.0, pulse_rate=65_000.0, image_interval=8.0,
                     image_width=480, image_height=360),
    "demo": _DEMO,
    "vmx450": replace(_DEMO, **_OWN),
    "vmq1ha": replace(_DEMO, **_OWN, scanner=SCANNERS["vmq1ha"]),
    "mx9": replace(_DEMO, **_OWN, scanner=SCANNERS["mx9"]),
    **{name: replace(_DEMO, **_OWN, scanner=SCANNERS[name], with_images=False) for name in _ROTATING},
    "cyclomedia": replace(_DEMO, **_OWN, scanner=SCANNERS["cyclomedia"], speed=5.0, with_images=False),
    "sick_side": replace(_DEMO, **_OWN, scanner=SCANNERS["sick_side"], speed=5.0, with_images=False),
    "oakland": replace(_DEMO, **_OWN, scanner=SCANNERS["oakland"], speed=7.0, with_images=False,
                       street=STREETS["campus"]),
}  # fmt: skip
"""Named parameters.

``tiny`` (some 30,000 points, for tests), ``small`` (half a million) and ``demo`` (2 to 4 million) are a VMX-450 at a
fraction of its rate. The others are `SCANNERS` at their own rates, without images but for ``vmx450``, ``vmq1ha`` and
``mx9``; the street of ``oakland`` is of the kind ``campus``.
"""


def simulation_parameters(config: Mapping[str, Any]) -> SimulationParameters:
    """Return the simulation parameters that a configuration describes."""
    changes = {name: value for name, value in config.items() if name == "scan_spacing" or name not in LAYOUT}
    preset, varied = changes.pop("preset", "demo"), changes.pop("varied", None)
    if preset not in PRESETS:
        raise ParameterError(f"simulation preset {preset!r} is unknown (presets: {', '.join(PRESETS)})")
    known = {field.name for field in fields(SimulationParameters)}
    unknown = sorted(set(changes) - known)
    if unknown:
        names = ", ".join(sorted(known | {"varied", *LAYOUT}))
        raise ParameterError(f"unknown simulation parameters: {', '.join(unknown)} (known: {names})")
    if "scanner" in changes:
        changes["scanner"] = scanner_system(changes["scanner"])
        if changes["scanner"] != PRESETS[preset].scanner:
            changes = {**dict.fromkeys(OF_THE_SCANNER), **changes}
    if "street" in changes:
        changes["street"] = street_parameters(changes["street"])
    parameters = replace(PRESETS[preset], **changes)
    return parameters if varied is None else _varied(parameters, variation(varied))


def another_year(
    parameters: SimulationParameters, year: int, *, offset: tuple[float, float, float] = (0.0, 0.0, 0.0), **changes: Any
) -> SimulationParameters:
    """Return the parameters of a survey of the same street in another year.

    Parameters
    ----------
    parameters : SimulationParameters
        The earlier survey.
    year : int
        Seed of what has changed, 1 to 200: see `StreetParameters.year`. It is the number of the first pass too.
    offset : tuple of float, default zeros
        Displacement of all coordinates of the later survey, metres.
    **changes
        Other parameters, such as another scanner; a scanner has its own rates unless they are given.

    Returns
    -------
    SimulationParameters
        The later survey.

    Raises
    ------
    ParameterError
        If a value is outside its domain.

    Examples
    --------
    >>> later = another_year(PRESETS["tiny"], 2, offset=(0.5, 0.0, 0.0))
    >>> later.street.year, later.first_pass, later.easting - PRESETS["tiny"].easting
    (2, 2, 0.5)
    """
    moved = {name: getattr(parameters, name) + way for name, way in zip(_ORIGIN, offset, strict=True)}
    own = dict.fromkeys(OF_THE_SCANNER) if "scanner" in changes else {}
    street = replace(changes.pop("street", parameters.street), year=year)
    return replace(parameters, **{**moved, **own, **changes, "street": street, "first_pass": year})


def _varied(parameters: SimulationParameters, change: Variation) -> SimulationParameters:
    """Return the parameters with a changed scanner; rates and noise of their own change likewise."""
    rate, noise = parameters.pulse_rate, parameters.range_noise
    return replace(
        parameters, scanner=change.applied(parameters.scanner), pulse_rate=None if rate is None else rate * change.rate,
        range_noise=None if noise is None else noise * change.noise,
    )  # fmt: skip


def expanded_surveys(surveys: Mapping[str, Mapping[str, Any] | None]) -> dict[str, Mapping[str, Any] | None]:
    """Replace each description with a ``count`` by that many surveys, named ``NAME_000`` and so on."""
    out: dict[str, Mapping[str, Any] | None] = {}
    for name, config in surveys.items():
        several = config is not None and "count" in config
        drawn = _drawn(name, config) if several and config is not None else {name: config}
        twice = sorted(set(drawn) & set(out))
        if twice:
            raise ParameterError(f"two simulated surveys are named {twice[0]!r}")
        out |= drawn
    return out


def _drawn(name: str, config: Mapping[str, Any]) -> dict[str, Mapping[str, Any]]:
    count, variety, seed = config["count"], config.get("variety", 0.5), config.get("seed", 0)
    presets, streets = list(config.get("presets", ())), list(config.get("streets", STREETS))
    whole = [(count, "count", 1), (seed, "seed", 0)]
    for value, key, least in whole:
        if isinstance(value, bool) or not isinstance(value, int) or value < least:
            raise ParameterError(f"{name}: {key} must be an integer >= {least}, got {value!r}")
    if isinstance(variety, bool) or not isinstance(variety, int | float) or not 0 <= variety <= 1:
        raise ParameterError(f"{name}: variety must be between 0 and 1, got {variety!r}")
    for names, known, key in ((presets, PRESETS, "presets"), (streets, STREETS, "streets")):
        wrong = [str(n) for n in names if n not in known]
        if not names or wrong:
            raise ParameterError(f"{name}: {key} must be some of {', '.join(known)}, got {', '.join(wrong) or 'none'}")
    factors = config.get("factors", {})
    unknown = [str(key) for key in factors if key not in _FACTORS]
    if unknown:
        raise ParameterError(f"{name}: factors must name some of {', '.join(_FACTORS)}, got {unknown[0]}")
    common = {key: value for key, value in config.items() if key not in _KEYS}
    surveys: dict[str, Mapping[str, Any]] = {}
    for k in range(count):
        rng = np.random.default_rng([seed, k])
        preset, kind = presets[k % len(presets)], streets[(k % len(presets) + k // len(presets)) % len(streets)]
        one = {"preset": preset, "seed": int(rng.integers(2**31)), **common}
        one |= {"street": _street(kind, float(variety), factors, rng)}
        surveys[f"{name}_{k:03d}"] = one | {"varied": _drawn_variation(preset, float(variety), rng)}
    return surveys


def _street(kind: str, variety: float, factors: Mapping[str, float], rng: np.random.Generator) -> dict[str, Any]:
    """Return a kind of street with other numbers of objects, bends and slopes."""
    base = STREETS[kind]
    street: dict[str, Any] = {"kind": kind}
    for name in _FACTORS:
        value = getattr(base, name) * factors.get(name, 1.0) * np.exp(0.6 * variety * rng.normal())
        street[name] = round(float(min(value, 5.0)), 2)
    for name in _SHARES:
        value = getattr(base, name) + 0.25 * variety * rng.normal() * (getattr(base, name) > 0)
        street[name] = round(float(np.clip(value, 0.0, 1.0)), 2)
    street["bends"] = round(float(np.clip(1.0 + variety * rng.uniform(-1.0, 0.5), 0.0, 1.5)), 2)
    street["slopes"] = round(float(np.clip(np.exp(0.6 * variety * rng.normal()), 0.0, 2.0)), 2)
    return street


def _drawn_variation(preset: str, variety: float, rng: np.random.Generator) -> dict[str, Any]:
    """Return the variation of a preset's scanner."""
    device = PRESETS[preset].scanner.devices[0]
    varied: dict[str, Any] = {
        "height": rng.uniform(-0.35, 0.45) * variety,
        "pitch": np.clip(1.5 * rng.normal(), -4, 4) * variety, "roll": np.clip(rng.normal(), -3, 3) * variety,
        "rate": 1.0 - variety * rng.uniform(-0.15, 0.5), "noise": np.exp(0.7 * variety * rng.normal()),
        "sensitivity": 3.0 * variety * rng.normal(), "dropout": 0.2 * variety * rng.random() ** 3,
    }  # fmt: skip
    varied = {key: round(float(value), 3) for key, value in varied.items()}
    upright = len(device.elevations) > 1
    sector, cut, scaled = rng.random(3)
    half, top, dark = rng.uniform(30.0, 120.0), rng.uniform(1.0, 6.0), rng.normal(5.0, 3.0)
    if upright and sector < _NARROW * variety and device.field == (-180.0, 180.0):
        varied["field"] = (round(-float(half), 1), round(float(half), 1))
    if upright and cut < _CUT * variety and max(device.elevations) > top:
        varied["top"] = round(float(top), 1)
    if scaled < 0.5 * variety:
        varied["intensity"] = (round(float(dark), 1), round(float(dark + rng.uniform(20.0, 36.0)), 1))
    return varied
