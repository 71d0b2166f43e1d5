"""Tables of road sections: separators and decimal commas."""

import pytest

from mlsroad_pipeline.label.inventory import read_sections


@pytest.mark.parametrize(
    "text",
    [
        "section,from_station,to_station\nA,0,12.5\nB,12.5,80\n",
        "section;from_station;to_station\nA;0;12,5\nB;12,5;80\n",
        "\ufeffsection;from_station;to_station\r\nA;0;12.5\r\nB;12.5;80\r\n",
        "section\tfrom_station\tto_station\nA\t0\t12,5\nB\t12,5\t80\n",
    ],
)
def test_sections_have_any_separator(tmp_path, text):
    path = tmp_path / "sections.csv"
    path.write_text(text, encoding="utf-8")
    table = read_sections(path)
    assert table["section"].tolist() == ["A", "B"]
    assert table["from_station"].tolist() == [0.0, 12.5]
    assert table["to_station"].tolist() == [12.5, 80.0]
