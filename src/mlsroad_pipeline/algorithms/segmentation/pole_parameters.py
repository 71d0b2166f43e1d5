"""Parameters of the separation of poles, gantries and plates, which the published normalised cut does not contain."""

from __future__ import annotations

from dataclasses import dataclass, fields

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.core.validation import check_positive


@dataclass(frozen=True)
class PoleRefinementParameters:
    """Geometric limits and fitted weights of the steps that refine the normalised cut around poles.

    None of these is in Yu et al. 2016. The steps find stems (`stems.py`), separate poles from trunks (`trunks.py`),
    take poles out of their clusters (`poles.py`) and take plates off masts (`plates.py`). Lengths are in metres, and
    voxels have an edge of about 0.1 m. `pole_intercept`, `pole_weights` and `trunk_weight` are fitted by
    `benchmarks/stem_weights.py` on the simulated training streets of the study of Yu et al. 2016; all other values are
    geometric limits set by hand.

    Parameters
    ----------
    section_height : float, default 0.2
        Height of a section of a stem. Larger sections hold more points and follow bends less closely.
    section_tolerance, section_max_width : float, default 0.15, 0.5
        Distance between voxels of one section, and its largest horizontal extent. Larger accepts wider stems.
    clearance_radius, clearance_ratio : float, default 0.4, 1.34
        A section stands free where at most `clearance_ratio` times its own voxels lie within this radius. A larger
        ratio accepts stems that something leans on.
    max_shift, max_slope, max_residual : float, default 0.12, 0.15, 0.05
        Largest horizontal step from one section to the next, slope of the axis (without unit), and root mean square
        deviation of the sections from it. Larger accepts leaning and crooked stems.
    stem_radius, stem_min_height : float, default 0.22, 1.7
        Voxels this close to the axis belong to a stem; shorter stems are discarded.
    core_radius, ring_radius, core_density_ratio : float, default 0.15, 0.45, 3.0
        A stem continues upwards where the density of points in the core is at least this multiple of that in the ring.
        A larger ratio ends stems earlier inside crowns.
    max_hidden_sections : int, default 4
        Number of sections above the end of a stem that are searched for its continuation. Larger bridges longer gaps.
    sign_height, sign_free_length : float, default 5.0, 0.6
        In clusters up to this height a post may stand free over `sign_free_length` alone.
    crown_radius, crown_tolerance, crown_min_voxels : float, float, int, default 2.0, 0.25, 300
        A stem stands in a crown where this many voxels lie within the radius. Voxels closer than the tolerance form one
        piece. Stems with fewer voxels around them are poles.
    crown_base, crown_top_quantile, crown_min_top : float, default 0.4, 0.98, 0.5
        Share of a stem's height below which no crown is measured, quantile of heights that is its top, and the least
        height of that top above the foot.
    crown_centre_offset : float, default 0.1
        A stem closer than this to the centre of its crown is a trunk if it is the least pole-like one nearby.
    trunk_distance : float, default 2.5
        Stems within this distance are compared to find the least pole-like one.
    spread_radius, spread_quantile, measure_base : float, default 0.3, 0.25, 0.2
        Radius of the voxels whose spread is measured, quantile of the sections' spreads, and height above the foot from
        which sections are measured.
    axis_radius, axis_core_radius, axis_iterations : float, float, int, default 0.45, 0.2, 4
        Search radius around the axis, radius of the mean shift, and its iterations per section.
    foliage_quantile, min_sections : float, int, default 0.4, 5
        Share of the sections that is left out, those with most points off their core, and the fewest that are measured.
    line_iterations, line_min_residual : int, float, default 8, 0.01
        Iterations of the line of least absolute deviations, and the residual below which weights are equal.
    log_offset, default_bend, default_spread : float, default 0.02, 0.05, 0.2
        Added to bend and slope before the logarithm, and the values of a stem of too few sections.
    pole_intercept, pole_weights : float, tuple of six floats, default -39.35, (-7.1, -3.19, -39.39, 2.97, 7.81, 0.55)
        Logistic regression for poles in crowns, fitted: a stem with a positive value is a pole. The weights are in the
        order of `measure_stem`. The intercept contains 0.41, the logarithm of 3/2, so that a stem is a pole from odds
        of two to three.
    trunk_weight : float, default -2.44
        Added for the least pole-like of neighbouring stems, fitted: every crown has a trunk.
    beam_height, beam_min_span, beam_min_voxels, beam_density : float, float, int, float, default 1.0, 5.0, 100, 80.0
        Largest height of a beam and of its distance from the post's top, least distance between two legs, least number
        of voxels around a leg, and least number of voxels per metre of span: wires have fewer.
    beam_quantiles : tuple of three floats, default (0.15, 0.5, 0.95)
        Quantiles of the heights that are bottom, middle and top of a beam.
    fixture_max_voxels, fixture_max_width, fixture_min_height : int, float, float, default 200, 4.0, 1.0
        Largest lamps, arms and plates of a pole, and their least height above its foot.
    fixture_tolerance, fixture_overhang : float, default 0.25, 0.5
        Distance between voxels of one fixture and from the stem, and height above the pole's top up to which it
        touches.
    arm_max_length, arm_max_width, arm_max_height, arm_min_height : float, default 12.0, 0.9, 1.6, 3.0
        Largest arm with signals, and its least height above the pole's foot.
    surround_radius, surround_ratio : float, default 0.45, 0.5
        A section is surrounded where more than this ratio of its own voxels lies between the stem and this radius.
    base_zone : float, default 1.2
        Height above the foot up to which objects stand beside a pole.
    pole_min_radius, pole_max_radius, pole_radius_margin : float, default 0.14, 0.22, 0.05
        Range of a pole's radius in surrounded sections of that zone, and what is added to the median distance above.
    remainder_tolerance : float, default 0.5
        What remains of a cluster without its poles is clustered again at this distance.
    post_max_distance, post_max_level : float, default 2.5, 0.5
        Largest distance between two posts of one plate, and the largest difference of their tops.
    mast_free_length : float, default 1.2
        Length over which a mast of plates stands free.
    mast_min_radius, mast_max_radius, mast_radius_margin : float, default 0.1, 0.25, 0.06
        Range of a mast's radius, and what is added to the measured one.
    mast_percentile, mast_search_radius, mast_search_base : float, default 75, 0.35, 0.4
        Percentile of the distances from the axis that measures the radius, and the largest distance and the least
        height above the foot of the voxels measured.
    plate_reach, plate_min_height, plate_max_height : float, default 1.2, 1.2, 5.5
        Largest distance of a plate from the axis, and its range of heights above the foot.
    plate_min_width, plate_min_extent, plate_max_size : float, default 0.3, 0.2, 1.6
        Least width, least height and largest width and height of a plate.
    plate_max_thickness, plate_max_tilt : float, default 0.075, 0.5
        Largest deviation from a plane, and largest vertical component of the normal (without unit).
    plate_min_voxels, plate_min_piece, plate_tolerance : int, int, float, default 8, 4, 0.2
        Least number of voxels of a plate and of a connected part of it, and largest distance between voxels of a part.
    plate_min_contrast : float, default 0.02
        Least difference of mean intensities between plate and mast, of intensities in [0, 1]. Larger takes off fewer.
    plate_back_factor : float, default 1.5
        Voxels on the mast belong to a plate within this multiple of its thickness from its plane.
    sheet_max_thickness, sheet_max_tilt, sheet_min_contrast : float, default 0.02, 0.1, -0.05
        The same limits for plates of sheet metal, which need not be brighter than the mast.
    sheet_min_width, sheet_max_width, sheet_max_extent : float, default 0.5, 1.3, 1.0
        Range of widths and largest height of such a sheet.
    sheet_max_neighbors : int, default 12
        Most voxels beside the mast above such a sheet: a sheet that need not be bright is the only plate there.
    voxel_half_edge : float, default 0.05
        Distance from a voxel's centre to its faces.

    Raises
    ------
    ParameterError
        If there are not six weights, or a length, number or ratio is not positive.
    """

    section_height: float = 0.2
    section_tolerance: float = 0.15
    section_max_width: float = 0.5
    clearance_radius: float = 0.4
    clearance_ratio: float = 1.34
    max_shift: float = 0.12
    max_slope: float = 0.15
    max_residual: float = 0.05
    stem_radius: float = 0.22
    stem_min_height: float = 1.7
    core_radius: float = 0.15
    ring_radius: float = 0.45
    core_density_ratio: float = 3.0
    max_hidden_sections: int = 4
    sign_height: float = 5.0
    sign_free_length: float = 0.6
    crown_radius: float = 2.0
    crown_tolerance: float = 0.25
    crown_min_voxels: int = 300
    crown_base: float = 0.4
    crown_top_quantile: float = 0.98
    crown_min_top: float = 0.5
    crown_centre_offset: float = 0.1
    trunk_distance: float = 2.5
    spread_radius: float = 0.3
    spread_quantile: float = 0.25
    measure_base: float = 0.2
    axis_radius: float = 0.45
    axis_core_radius: float = 0.2
    axis_iterations: int = 4
    foliage_quantile: float = 0.4
    min_sections: int = 5
    line_iterations: int = 8
    line_min_residual: float = 0.01
    log_offset: float = 0.02
    default_bend: float = 0.05
    default_spread: float = 0.2
    pole_intercept: float = -39.35
    pole_weights: tuple[float, ...] = (-7.1, -3.19, -39.39, 2.97, 7.81, 0.55)
    trunk_weight: float = -2.44
    beam_height: float = 1.0
    beam_min_span: float = 5.0
    beam_min_voxels: int = 100
    beam_density: float = 80.0
    beam_quantiles: tuple[float, ...] = (0.15, 0.5, 0.95)
    fixture_max_voxels: int = 200
    fixture_max_width: float = 4.0
    fixture_min_height: float = 1.0
    fixture_tolerance: float = 0.25
    fixture_overhang: float = 0.5
    arm_max_length: float = 12.0
    arm_max_width: float = 0.9
    arm_max_height: float = 1.6
    arm_min_height: float = 3.0
    surround_radius: float = 0.45
    surround_ratio: float = 0.5
    base_zone: float = 1.2
    pole_min_radius: float = 0.14
    pole_max_radius: float = 0.22
    pole_radius_margin: float = 0.05
    remainder_tolerance: float = 0.5
    post_max_distance: float = 2.5
    post_max_level: float = 0.5
    mast_free_length: float = 1.2
    mast_min_radius: float = 0.1
    mast_max_radius: float = 0.25
    mast_radius_margin: float = 0.06
    mast_percentile: float = 75
    mast_search_radius: float = 0.35
    mast_search_base: float = 0.4
    plate_reach: float = 1.2
    plate_min_height: float = 1.2
    plate_max_height: float = 5.5
    plate_min_width: float = 0.3
    plate_min_extent: float = 0.2
    plate_max_size: float = 1.6
    plate_max_thickness: float = 0.075
    plate_max_tilt: float = 0.5
    plate_min_voxels: int = 8
    plate_min_piece: int = 4
    plate_tolerance: float = 0.2
    plate_min_contrast: float = 0.02
    plate_back_factor: float = 1.5
    sheet_max_thickness: float = 0.02
    sheet_max_tilt: float = 0.1
    sheet_min_contrast: float = -0.05
    sheet_min_width: float = 0.5
    sheet_max_width: float = 1.3
    sheet_max_extent: float = 1.0
    sheet_max_neighbors: int = 12
    voxel_half_edge: float = 0.05

    def __post_init__(self) -> None:
        if len(self.pole_weights) != 6:
            raise ParameterError(f"pole_weights must be six numbers, one per measure, got {len(self.pole_weights)}")
        signed = {"pole_intercept", "pole_weights", "trunk_weight", "plate_min_contrast", "sheet_min_contrast"}
        for name in (field.name for field in fields(self) if field.name not in signed | {"beam_quantiles"}):
            check_positive(getattr(self, name), name)


POLE_REFINEMENT = PoleRefinementParameters()
"""Default values."""
