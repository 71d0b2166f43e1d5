"""Layers of the lines of a road, importable without pandas."""

LINE_LAYERS = {
    "kerbs": "kerb",
    "wires": "wire",
    "lane_lines": "lane_line",
    "stop_lines": "stop_line",
    "crossings": "crossing",
    "other_markings": "other_marking",
}
"""Layer name to kind of line."""
