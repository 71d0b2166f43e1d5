"""The configuration of the visual words as printed: the values of Yu et al. 2016."""

from helpers.conf import base

from mlsroad_pipeline.algorithms.segmentation.stage import SegmentationParameters
from mlsroad_pipeline.papers.yu2016.visual_words.training import VisualWordsParameters


def test_the_configuration_as_printed_has_the_values_of_the_paper():
    words = VisualWordsParameters(**base("visual_words_printed"))
    assert (words.regions.voxel_size, words.regions.seed_resolution) == (0.05, 0.1)  # section III-A
    assert (words.regions.pattern, words.k) == ("first_order", 2)  # section V-C
    assert words.vocabulary.floor == 0.0  # equation 16
    detector = words.detector
    assert (detector.decision, detector.size_share, detector.profile_share, detector.size_margin) == (
        "nearest",
        0,
        0,
        0,
    )
    cut = SegmentationParameters(**base("segmentation")).printed_cut
    # Table I
    assert (cut.tolerance, cut.voxel_size, cut.max_distance) == (0.15, 0.1, 5.0)
    assert (cut.sigma_h, cut.sigma_v, cut.sigma_i) == (2.0, 10.0, 1.0)
    additions = (cut.spacing_factor, cut.smoothing, cut.tall_smoothing, cut.low_height, cut.pole_length)
    assert (*additions, cut.foot_height, cut.pole_gap, cut.plate_gap) == (0.0,) * 8
