"""Layers of the lines of a road; without pandas, for the page."""

LINE_LAYERS = {
    "kerbs": "kerb",
    "wires": "wire",
    "barriers": "barrier",
    "lane_lines": "lane_line",
    "stop_lines": "stop_line",
    "crossings": "crossing",
    "other_markings": "other_marking",
}
"""Layer name to kind of line."""

LINE_KINDS = tuple(LINE_LAYERS.values())
"""Kinds of lines."""
