"""The parameters of a simulated survey, and named sets of them."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import pyproj

from mlsroad_pipeline.algorithms.exceptions import ParameterError
from mlsroad_pipeline.algorithms.simulation.street_parameters import StreetParameters
from mlsroad_pipeline.algorithms.validation import check_positive


@dataclass(frozen=True)
class SimulationParameters:
    """What is surveyed, and how.

    Parameters
    ----------
    seed : int, default 0
        Non-negative. The street, everything on it and all noise follow from it.
    length : float, default 150
        Surveyed length along the street, metres, 10 to 5000; the street itself goes on at both ends.
    speed : float, default 10
        Mean speed of the van, m/s. Slower is denser along the street.
    profile_rate : float, default 200
        Revolutions per second of each scanner; 200 is the VMX-450's.
    pulse_rate : float, default 180000
        Pulses per second of each scanner; about two thirds of them come back. The VMX-450 reaches 550000.
    range_noise : float, default 0.005
        Standard deviation of a strong return's range, metres; weak returns are noisier.
    beam_divergence : float, default 0.0003
        Full angle of the beam, radians. Larger mixes more pixels at edges.
    max_range : float, default 120
        Longest range that is recorded, metres.
    trajectory_noise : float, default 1.0
        Factor on the error of the reported trajectory, which is about 1 cm and 0.005 degrees at 1; 0 is none.
    with_images : bool, default True
        Whether three cameras take images that colour the points. Without them points have the colour of what they
        hit under the sun, without cast shadows.
    image_width, image_height : int, default 640, 480
        Size of the images, pixels.
    image_interval : float, default 8
        Distance between images of one camera, metres.
    easting, northing, height : float, default 389300, 5819700, 34
        World coordinates where the street begins, metres.
    epsg : int, default 25833
        Projected coordinate reference system in metres.
    start_time : float, default 216000
        GPS seconds of the week at the start of the drive.
    street : StreetParameters
        What kind of street it is; see `STREETS`.

    Raises
    ------
    ParameterError
        If a value is outside its domain, or if `epsg` is not a projected system in metres.
    """

    seed: int = 0
    length: float = 150.0
    speed: float = 10.0
    profile_rate: float = 200.0
    pulse_rate: float = 180_000.0
    range_noise: float = 0.005
    beam_divergence: float = 0.0003
    max_range: float = 120.0
    trajectory_noise: float = 1.0
    with_images: bool = True
    image_width: int = 640
    image_height: int = 480
    image_interval: float = 8.0
    easting: float = 389_300.0
    northing: float = 5_819_700.0
    height: float = 34.0
    epsg: int = 25833
    start_time: float = 216_000.0
    street: StreetParameters = field(default_factory=StreetParameters)

    def __post_init__(self) -> None:
        if isinstance(self.seed, bool) or self.seed != int(self.seed) or self.seed < 0:
            raise ParameterError(f"seed must be an integer >= 0, got {self.seed!r}")
        for name in ("speed", "profile_rate", "pulse_rate", "beam_divergence", "max_range", "image_interval"):
            check_positive(getattr(self, name), name)
        if not 10 <= self.length <= 5000:
            raise ParameterError(f"length must be between 10 and 5000 m, got {self.length!r}")
        for name in ("range_noise", "trajectory_noise"):
            if not 0 <= getattr(self, name) < 100:
                raise ParameterError(f"{name} must be between 0 and 100, got {getattr(self, name)!r}")
        for name in ("image_width", "image_height"):
            if not 16 <= getattr(self, name) <= 8192:
                raise ParameterError(f"{name} must be between 16 and 8192 pixels, got {getattr(self, name)!r}")
        if self.pulse_rate < 16 * self.profile_rate:
            raise ParameterError(
                f"pulse_rate must be at least 16 pulses per profile, got {self.pulse_rate!r} for "
                f"profile_rate {self.profile_rate!r}"
            )
        for name, low, high in (("easting", -1e8, 1e8), ("northing", -1e8, 1e8), ("height", -500, 9000)):
            if not low <= getattr(self, name) <= high:
                raise ParameterError(f"{name} must be between {low:g} and {high:g} m, got {getattr(self, name)!r}")
        if not 0 <= self.start_time < 1e10:
            raise ParameterError(f"start_time must be between 0 and 1e10 s, got {self.start_time!r}")
        self.crs_wkt()

    def crs_wkt(self) -> str:
        """Return the coordinate reference system as WKT.

        Returns
        -------
        str
            WKT 2.

        Raises
        ------
        ParameterError
            If `epsg` is unknown, or not a projected system in metres.
        """
        try:
            crs = pyproj.CRS.from_epsg(self.epsg)
        except pyproj.exceptions.CRSError as error:
            raise ParameterError(f"epsg {self.epsg!r} is not a known coordinate reference system") from error
        if not crs.is_projected or crs.axis_info[0].unit_name != "metre":
            raise ParameterError(f"epsg {self.epsg!r} must be a projected system in metres, is {crs.name!r}")
        return str(crs.to_wkt())


_DEMO = SimulationParameters()

PRESETS: dict[str, SimulationParameters] = {
    "tiny": replace(_DEMO, length=30.0, speed=14.0, profile_rate=50.0, pulse_rate=14_000.0, image_interval=15.0,
                    image_width=240, image_height=180),
    "small": replace(_DEMO, length=80.0, speed=10.0, profile_rate=100.0, pulse_rate=65_000.0, image_interval=8.0,
                     image_width=480, image_height=360),
    "demo": _DEMO,
}  # fmt: skip
"""Named parameters: ``tiny`` (some 30,000 points, for tests), ``small`` (half a million), ``demo`` (2 to 4 million)."""
