"""Comparison of coordinate reference systems of vector files."""

from pyproj import CRS
from pyproj.exceptions import CRSError


def known_system(given: object) -> CRS | None:
    """Return a coordinate reference system, None where it is missing, undefined or not understood."""
    try:
        system = None if given is None else CRS.from_user_input(given)
    except CRSError:
        return None
    return None if system is None or "Undefined" in system.name else system


def is_other_system(given: object, system: CRS | None) -> bool:
    """Return whether both systems are known and their horizontal parts differ."""
    own = known_system(given)
    if own is None or system is None:
        return False
    one, other = (crs.sub_crs_list[0] if crs.is_compound else crs for crs in (own, system))
    return not (one.equals(other, ignore_axis_order=True) or one.name == other.name)
