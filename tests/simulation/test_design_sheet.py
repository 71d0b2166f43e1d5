import numpy as np
from design_sheet import design_sheet, photograph, scan_mesh

from mlsroad_pipeline.simulation.model.meshes import Design, Surface
from mlsroad_pipeline.simulation.model.solids import box

RED_BOX = box([1.0, 1.0, 2.0], [0, 0, 1.0], Surface(77, (0.6, 0.1, 0.1), 0.5))


def _build(rng):
    return box(rng.uniform(0.5, 1.0, 3), [0, 0, 0.5], Surface(77, (0.6, 0.1, 0.1), 0.5))


def test_a_box_seen_from_the_front_is_a_rectangle():
    picture = photograph(RED_BOX, size=(120, 100), span=2.5, azimuth=0.0, elevation=1e-6)
    painted = (picture != 255).any(axis=2)
    rows, columns = np.flatnonzero(painted.any(axis=1)), np.flatnonzero(painted.any(axis=0))
    # 40 pixels to the metre; the foot is 3 % of the span above the lower edge.
    assert len(rows) == 80 and len(columns) == 40
    assert painted[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1].all()
    assert rows[-1] == 100 - 3 - 1
    assert picture[painted][:, 0].mean() > picture[painted][:, 1].mean()


def test_a_scan_lies_on_the_faces_that_the_van_sees():
    xyz, rgb, face = scan_mesh(RED_BOX, spacing=0.05)
    assert len(xyz) == len(rgb) == len(face) > 1000
    assert (np.abs(xyz[:, 1] + 0.5) < 1e-4).mean() > 0.5
    outside = np.abs(xyz - [0, 0, 1.0]) / [0.5, 0.5, 1.0]
    np.testing.assert_allclose(outside.max(axis=1), 1.0, atol=1e-4)
    corners = RED_BOX.vertices[RED_BOX.faces[face]]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert (normal[:, 1] > 0).mean() < 0.01  # the back is hidden but for its edges
    np.testing.assert_allclose(((xyz - corners[:, 0]) * normal).sum(axis=1), 0, atol=1e-4)


def test_sheets_show_every_individual_once():
    designs = [Design(f"box_{k}", "other_object", _build, 1.0) for k in range(3)]
    for style in ("photograph", "points", "labels"):
        figure = design_sheet(designs, seeds=(1, 2), cell=(60, 50), style=style)
        assert len(figure.axes) == 6
        titles = [axes.get_title() for axes in figure.axes]
        assert [title.startswith("box_") for title in titles] == [True, False] * 3
        pictures = [axes.images[0].get_array() for axes in figure.axes]
        assert all((picture != 255).any() for picture in pictures)
