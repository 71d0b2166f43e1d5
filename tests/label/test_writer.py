"""Labelled surveys: every point, every attribute, and the labels beside them."""

import laspy
import numpy as np
import pytest
from helpers.formats import LAYOUTS, check_written_labels, las_column, make_labels, make_las, raw_vlrs
from laspy.vlrs.vlr import VLR

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError, ReadError
from mlsroad_pipeline.label.writer import write_labelled


def check_kept(old, new):
    for name in old.point_format.dimension_names:
        values = las_column(old, name)
        if name == "classification":
            np.testing.assert_array_equal(new["original_classification"], values)
        elif name == "scan_angle_rank":
            np.testing.assert_array_equal(np.rint(las_column(new, "scan_angle") * 0.006), values)
        else:
            np.testing.assert_array_equal(las_column(new, name), values)


@pytest.mark.parametrize(("version", "point_format"), LAYOUTS)
@pytest.mark.parametrize("extension", ["las", "laz"])
def test_nothing_is_lost(tmp_path, rng, version, point_format, extension):
    source, target = tmp_path / f"a.{extension}", tmp_path / "out" / "a.laz"
    old = make_las(source, rng, version=version, point_format=point_format, geotiff=25832)
    before = source.read_bytes()
    assert write_labelled(source, target, make_labels, chunk_size=128) == [target]
    assert source.read_bytes() == before
    new = laspy.read(target)
    check_written_labels(new)
    check_kept(old, new)
    assert new.point_format.id == {0: 6, 1: 6, 2: 7, 3: 7, 4: 9, 5: 10}.get(point_format, point_format)
    for field in ("scales", "offsets", "mins", "maxs"):
        np.testing.assert_array_equal(getattr(new.header, field), getattr(old.header, field))
    for field in ("creation_date", "system_identifier", "generating_software", "uuid", "file_source_id"):
        assert getattr(new.header, field) == getattr(old.header, field)
    assert new.header.global_encoding.gps_time_type == old.header.global_encoding.gps_time_type
    np.testing.assert_array_equal(
        new.header.number_of_points_by_return, np.bincount(old.return_number, minlength=16)[1:]
    )
    own = [v for v in raw_vlrs(source) if v[1] == 0 or not v[0].startswith((b"laszip", b"LASF_Spec"))]
    assert [v for v in raw_vlrs(target) if v in own] == own
    assert [v.record_data for v in new.evlrs] == [v.record_data for v in old.evlrs or []]
    for name in ("deviation", "normal", "height"):
        kept, was = new.point_format.dimension_by_name(name), old.point_format.dimension_by_name(name)
        assert repr(kept) == repr(was)
    if point_format < 6:
        assert new.header.global_encoding.wkt
    assert new.header.parse_crs().to_epsg() == 25832


@pytest.mark.parametrize("point_format", [9, 10])
def test_what_lazrs_would_damage_is_refused(tmp_path, rng, point_format):
    make_las(tmp_path / "a.las", rng, point_format=point_format, channels=True)
    with pytest.raises(DataError, match=rf"format {point_format} with waveform packets of several scanner channels"):
        write_labelled(tmp_path / "a.las", tmp_path / "b.laz", make_labels)
    assert [p.name for p in tmp_path.iterdir()] == ["a.las"]


@pytest.mark.parametrize("point_format", [3, 6, 7, 8])
def test_same_bytes_whatever_the_threads_and_ranges(tmp_path, rng, point_format):
    source = tmp_path / "a.laz"
    make_las(source, rng, version="1.4", point_format=point_format, n=60_001)  # two chunks
    written = []
    for at, (n_threads, chunk_size) in enumerate([(1, 1_000_000), (2, 1_000_000), (1, 33_333), (2, 25_000)]):
        target = tmp_path / f"{at}.laz"
        write_labelled(source, target, make_labels, n_threads=n_threads, chunk_size=chunk_size)
        written.append(target.read_bytes())
    assert all(data == written[0] for data in written)


def test_no_classes_leave_no_original(tmp_path, rng):
    for extension, point_format in (("las", 3), ("laz", 6), ("laz", 1)):
        source = tmp_path / f"a.{extension}"
        las = make_las(source, rng, point_format=point_format, extras=False)
        las.classification[:] = 0
        las.write(str(source))
        write_labelled(source, tmp_path / "b.laz", make_labels)
        new = laspy.read(tmp_path / "b.laz")
        assert list(new.point_format.extra_dimension_names) == ["confidence", "object_id"]
        np.testing.assert_array_equal(las_column(new, "synthetic"), las_column(las, "synthetic"))
        las.classification[-1] = 1  # a single class, in the last point
        las.write(str(source))
        write_labelled(source, tmp_path / "b.laz", make_labels)
        assert laspy.read(tmp_path / "b.laz")["original_classification"].tolist() == [0] * 299 + [1]


def test_labelling_again_keeps_what_came_first(tmp_path, rng):
    source = tmp_path / "a.laz"
    old = make_las(source, rng)
    write_labelled(
        source,
        tmp_path / "b.laz",
        lambda start, stop: (
            np.full(stop - start, 9, np.uint8),
            np.zeros(stop - start, np.float32),
            np.full(stop - start, 2**32 - 1, np.uint32),
        ),
    )
    write_labelled(tmp_path / "b.laz", tmp_path / "c.laz", make_labels)
    write_labelled(tmp_path / "c.laz", tmp_path / "d.laz", make_labels)
    again, thrice = laspy.read(tmp_path / "c.laz"), laspy.read(tmp_path / "d.laz")
    check_written_labels(again)
    check_kept(old, again)
    np.testing.assert_array_equal(again["original_confidence"], 0)
    np.testing.assert_array_equal(again["original_object_id"], 2**32 - 1)
    np.testing.assert_array_equal(thrice.points.array, again.points.array)


def test_records_of_a_cloud_optimised_file_are_dropped(tmp_path, rng):
    las = make_las(tmp_path / "a.laz", rng, point_format=6)
    las.vlrs.insert(0, VLR("copc", 1, "info", bytes(160)))
    las.evlrs.append(VLR("copc", 1000, "hierarchy", bytes(32)))
    las.write(str(tmp_path / "a.laz"))
    write_labelled(tmp_path / "a.laz", tmp_path / "b.laz", make_labels)
    new = laspy.read(tmp_path / "b.laz")
    assert "copc" not in [v.user_id for v in [*new.vlrs, *new.evlrs]]
    assert [v.record_id for v in new.evlrs] == [78]


@pytest.mark.parametrize("n", [0, 1])
def test_no_point_and_one_point(tmp_path, rng, n):
    make_las(tmp_path / "a.laz", rng, n=n)
    write_labelled(tmp_path / "a.laz", tmp_path / "b.laz", make_labels, n_threads=2)
    assert len(laspy.read(tmp_path / "b.laz")) == n


def test_ranges_progress_and_failures(tmp_path, rng):
    source, target = tmp_path / "a.laz", tmp_path / "b.laz"
    make_las(source, rng)
    asked, done = [], []

    def labels_of(start, stop):
        asked.append((start, stop))
        return make_labels(start, stop)

    write_labelled(source, target, labels_of, chunk_size=128, progress=done.append)
    assert (asked, done) == ([(0, 128), (128, 256), (256, 300)], [128, 128, 44])
    target.unlink()
    cases = [
        (lambda a, b: (make_labels(a, b)[0][1:], *make_labels(a, b)[1:]), DataError, r"class codes for rows 0 to 299"),
        (lambda a, b: (*make_labels(a, b)[:2], make_labels(a, b)[2][1:]), DataError, r"objects for rows 0 to 299"),
        (lambda a, b: (np.zeros(b - a), *make_labels(a, b)[1:]), DataError, r"must be uint8, got float64"),
    ]
    for labels, error, message in cases:
        with pytest.raises(error, match=message):
            write_labelled(source, target, labels)
        assert sorted(p.name for p in tmp_path.iterdir()) == ["a.laz"]
    with pytest.raises(DataError, match=r"a\.laz is the survey itself"):
        write_labelled(source, source, make_labels)
    with pytest.raises(ParameterError, match=r"written as \.laz, got .*b\.las"):
        write_labelled(source, tmp_path / "b.las", make_labels)
    with pytest.raises(ParameterError, match=r"chunk_size .*got 0"):
        write_labelled(source, target, make_labels, chunk_size=0)
    source.write_bytes(source.read_bytes()[:-90_000])
    with pytest.raises(ReadError, match=r"a\.laz is (damaged|truncated)"):
        write_labelled(source, target, make_labels)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.laz"]


@pytest.mark.real_data
@pytest.mark.parametrize("parts", [("amsterdam", "run1_sidewalk_2386_9702.laz"), ("jakarto", "test_0.02_seconde.las")])
def test_recordings(tmp_path, real_data, parts):
    source = real_data(*parts)
    write_labelled(source, tmp_path / "a.laz", make_labels, n_threads=2)
    old, new = laspy.read(source), laspy.read(tmp_path / "a.laz")
    check_written_labels(new)
    for name in set(old.point_format.dimension_names) - {"classification", "scan_angle_rank"}:
        np.testing.assert_array_equal(las_column(new, name), las_column(old, name))
    np.testing.assert_array_equal(new.header.offsets, old.header.offsets)
    np.testing.assert_array_equal(new.header.mins, old.header.mins)
    assert new.header.creation_date == old.header.creation_date
