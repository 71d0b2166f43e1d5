"""Optional packages of libraries that are kept from being imported."""

import sys

import pytest

from mlsroad_pipeline.execution.optional_imports import without


def test_packages_seem_absent_until_the_end_unless_they_are_loaded(monkeypatch):
    monkeypatch.delitem(sys.modules, "colorsys", raising=False)
    with without("colorsys", "sys"):
        import sys as loaded

        with pytest.raises(ImportError):
            import colorsys
    import colorsys

    assert loaded is sys and colorsys.rgb_to_hsv(0, 0, 0) == (0, 0, 0)
