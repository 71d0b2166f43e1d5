"""Edits of a GeoPackage through the library of GDAL in pyogrio, as QGIS makes them: row by row, in place."""

import ctypes
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pyogrio

_POINTER, _TEXT, _NUMBER = ctypes.c_void_p, ctypes.c_char_p, ctypes.c_longlong
_FUNCTIONS = {
    "GDALOpenEx": (_POINTER, _TEXT, ctypes.c_uint, _POINTER, _POINTER, _POINTER),
    "GDALDatasetGetLayerByName": (_POINTER, _POINTER, _TEXT),
    "GDALClose": (ctypes.c_int, _POINTER),
    "OGR_L_GetLayerDefn": (_POINTER, _POINTER),
    "OGR_L_GetFeature": (_POINTER, _POINTER, _NUMBER),
    "OGR_L_SetFeature": (ctypes.c_int, _POINTER, _POINTER),
    "OGR_L_CreateFeature": (ctypes.c_int, _POINTER, _POINTER),
    "OGR_L_DeleteFeature": (ctypes.c_int, _POINTER, _NUMBER),
    "OGR_L_TestCapability": (ctypes.c_int, _POINTER, _TEXT),
    "OGR_F_Create": (_POINTER, _POINTER),
    "OGR_F_Destroy": (None, _POINTER),
    "OGR_F_GetFieldIndex": (ctypes.c_int, _POINTER, _TEXT),
    "OGR_F_SetFieldString": (None, _POINTER, ctypes.c_int, _TEXT),
    "OGR_F_SetGeometryDirectly": (ctypes.c_int, _POINTER, _POINTER),
    "OGR_G_CreateFromWkt": (ctypes.c_int, _POINTER, _POINTER, _POINTER),
}
_VECTOR_UPDATE = 5  # flags of GDALOpenEx


def _library():
    (path,) = (Path(pyogrio.__file__).parent.parent / "pyogrio.libs").glob("libgdal*")
    library = ctypes.CDLL(str(path))
    for name, (result, *arguments) in _FUNCTIONS.items():
        function = getattr(library, name)
        function.restype, function.argtypes = result, arguments
    return library


class Layer:
    """Layer that is open for edits; rows are named by their number in the file."""

    def __init__(self, library, layer) -> None:
        self._gdal, self._layer = library, layer

    def can(self, capability: str) -> bool:
        return bool(self._gdal.OGR_L_TestCapability(self._layer, capability.encode()))

    def _fill(self, feature, wkt, values) -> None:
        for name, value in values.items():
            index = self._gdal.OGR_F_GetFieldIndex(feature, name.encode())
            assert index >= 0, name
            self._gdal.OGR_F_SetFieldString(feature, index, str(value).encode())
        if wkt:
            shape, text = _POINTER(), _TEXT(wkt.encode())
            assert self._gdal.OGR_G_CreateFromWkt(ctypes.byref(text), None, ctypes.byref(shape)) == 0
            assert self._gdal.OGR_F_SetGeometryDirectly(feature, shape) == 0

    def change(self, fid: int, *, wkt: str = "", **values) -> None:
        feature = self._gdal.OGR_L_GetFeature(self._layer, fid)
        self._fill(feature, wkt, values)
        assert self._gdal.OGR_L_SetFeature(self._layer, feature) == 0
        self._gdal.OGR_F_Destroy(feature)

    def add(self, *, wkt: str, **values) -> None:
        feature = self._gdal.OGR_F_Create(self._gdal.OGR_L_GetLayerDefn(self._layer))
        self._fill(feature, wkt, values)
        assert self._gdal.OGR_L_CreateFeature(self._layer, feature) == 0
        self._gdal.OGR_F_Destroy(feature)

    def delete(self, fid: int) -> None:
        assert self._gdal.OGR_L_DeleteFeature(self._layer, fid) == 0


@contextmanager
def opened(path: Path, layer: str) -> Iterator[Layer]:
    library = _library()
    dataset = library.GDALOpenEx(str(path).encode(), _VECTOR_UPDATE, None, None, None)
    assert dataset, path
    try:
        yield Layer(library, library.GDALDatasetGetLayerByName(dataset, layer.encode()))
    finally:
        assert library.GDALClose(dataset) == 0
