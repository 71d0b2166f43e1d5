"""Draw an inventory as QGIS shows it, with its own styles and legend.

    /usr/bin/python3 benchmarks/inventory_in_qgis.py INVENTORY.gpkg OUT.png [--width 100] [--centre X Y]

Needs QGIS (Debian: ``apt-get install python3-qgis qgis-providers``), whose Python is that of the system. Ends with an
error if a layer does not open or brings no style. The map is `--width` metres wide, around the middle of the objects.
"""

import argparse
import os
import sys

os.environ.setdefault("QT_QPA_PLATFORM", "offscreen")

from qgis.core import (
    QgsApplication,
    QgsLayoutExporter,
    QgsLayoutItemLegend,
    QgsLayoutItemMap,
    QgsLayoutPoint,
    QgsLayoutSize,
    QgsPrintLayout,
    QgsProject,
    QgsRectangle,
    QgsVectorLayer,
)

# From the bottom of the map to its top; "objects" repeats the others: its symbols are off until they are ticked.
LAYERS = ("footprints", "trees", "vehicles", "trajectory", "poles", "signs", "objects")
PAGE = (297.0, 210.0)
LEGEND = 78.0


def open_layers(path: str) -> list[QgsVectorLayer]:
    """Open the layers with the styles that the file brings."""
    layers = []
    for name in LAYERS:
        layer = QgsVectorLayer(f"{path}|layername={name}", name, "ogr")
        if not layer.isValid():
            if name == "trajectory":
                continue  # a survey may have none
            sys.exit(f"{path}: QGIS does not open the layer {name!r}")
        message, loaded = layer.loadDefaultStyle()
        if not loaded:
            sys.exit(f"{path}: the layer {name!r} brings no style: {message}")
        print(f"{name}: {layer.featureCount()} features, {layer.crs().authid() or 'no coordinate system'}")
        layers.append(layer)
    return layers


def compose(project: QgsProject, layers: list[QgsVectorLayer], extent: QgsRectangle) -> QgsPrintLayout:
    """Lay out the map and its legend."""
    layout = QgsPrintLayout(project)
    layout.initializeDefaults()
    drawn = QgsLayoutItemMap(layout)
    layout.addLayoutItem(drawn)
    drawn.attemptMove(QgsLayoutPoint(LEGEND, 0))
    drawn.attemptResize(QgsLayoutSize(PAGE[0] - LEGEND, PAGE[1]))
    drawn.setFrameEnabled(True)
    drawn.setLayers(layers[::-1])
    drawn.setExtent(extent)
    legend = QgsLayoutItemLegend(layout)
    layout.addLayoutItem(legend)
    legend.setLinkedMap(drawn)
    legend.attemptMove(QgsLayoutPoint(2, 2))
    return layout


def main() -> int:
    """Draw an inventory."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("inventory")
    parser.add_argument("picture")
    parser.add_argument("--width", type=float, default=100.0)
    parser.add_argument("--centre", type=float, nargs=2)
    options = parser.parse_args()
    application = QgsApplication([], False)
    application.initQgis()
    project = QgsProject.instance()
    layers = open_layers(options.inventory)
    project.setCrs(layers[0].crs())  # as the first layer of an empty project does in the window
    project.addMapLayers(layers)
    middle = layers[0].extent().center()
    x, y = options.centre or (middle.x(), middle.y())
    half_height = 0.5 * options.width * PAGE[1] / (PAGE[0] - LEGEND)
    extent = QgsRectangle(x - options.width / 2, y - half_height, x + options.width / 2, y + half_height)
    settings = QgsLayoutExporter.ImageExportSettings()
    settings.dpi = 110
    layout = compose(project, layers, extent)
    failed = QgsLayoutExporter(layout).exportToImage(options.picture, settings)
    if failed:
        sys.exit(f"{options.picture} could not be written")
    return 0


if __name__ == "__main__":
    sys.exit(main())
