"""Layout of a point cloud as LAS records."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.formats.base import WriteOptions
from mlsroad_pipeline.formats.crs import is_geographic
from mlsroad_pipeline.formats.las import header as las
from mlsroad_pipeline.formats.las.crs import with_wkt
from mlsroad_pipeline.formats.las.dimensions import Depths, bit_field, dimension_names, extra_dimension
from mlsroad_pipeline.formats.las.extra import DESCRIPTOR, DESCRIPTOR_TYPES, ExtraDimension, pack_descriptors
from mlsroad_pipeline.formats.las.records import record_dtype, unique_names

DERIVED = ("rgb", "rgb16")  # columns that are written as red, green and blue
# Types without a descriptor to those that hold their values.
STORED_AS: dict[str, np.dtype] = {"b1": np.dtype("u1"), "f2": np.dtype("f4"), "f16": np.dtype("f8")}
SOFTWARE = b"mlsroad"
MOST_DIMENSIONS, LARGEST_RECORD = 65535 // DESCRIPTOR.itemsize, 65535  # limits of the Extra Bytes record and of a point
SINGLE_RETURN = (0x09, 0x11)  # bits of the first of one return in point formats 0 to 5, and 6 to 10
# Resolution of longitudes and latitudes, degrees: 11 mm, the finest that holds all of them in 32 bits.
DEGREE_STEP = 1e-7


def with_extra(
    header: las.LasHeader, added: list[ExtraDimension], *, existing: list[ExtraDimension], source: str = "the cloud"
) -> las.LasHeader:
    """Add extra dimensions to a header; `DataError`, which names the source, if LAS cannot hold so many.

    ``existing`` are the dimensions of the header in their order, possibly renamed. The record that describes them stays
    at its index.
    """
    if not existing and not added:
        return header
    names = unique_names(header.point_format, [d.name for d in (*existing, *added)])
    dimensions = [d if d.name == name else d.renamed(name) for d, name in zip((*existing, *added), names, strict=True)]
    size = header.record_size + sum(d.dtype.itemsize * d.width for d in added)
    if len(dimensions) > MOST_DIMENSIONS or size > LARGEST_RECORD:
        raise DataError(
            f"{source}: {len(dimensions)} extra dimensions in points of {size} bytes, of which LAS holds "
            f"{MOST_DIMENSIONS} in {LARGEST_RECORD}: leave columns out, the last is {dimensions[-1].name!r}"
        )
    record = las.Vlr(*las.EXTRA_BYTES, pack_descriptors(dimensions), b"Extra Bytes Record")
    old = [vlr for vlr in (*header.vlrs, *header.evlrs) if vlr.key == las.EXTRA_BYTES]
    if old:
        record = replace(record, description=old[0].description, reserved=old[0].reserved)
    at = next((i for i, vlr in enumerate(header.vlrs) if vlr.key == las.EXTRA_BYTES), len(header.vlrs))
    others = [vlr for vlr in header.vlrs if vlr.key != las.EXTRA_BYTES]
    vlrs = (*others[:at], record, *others[at:])
    evlrs = tuple(vlr for vlr in header.evlrs if vlr.key != las.EXTRA_BYTES)
    return replace(header, vlrs=vlrs, evlrs=evlrs).patched(record_size=size)


def _extra_for(cloud: PointCloud, header: las.LasHeader) -> list[ExtraDimension]:
    """Return dimensions for the columns of a cloud that a header lacks."""
    added, known = [], {*dimension_names(header)[3:], *"XYZ", *DERIVED}  # the first three are x, y and z
    for name, values in cloud.columns.items():
        if name in known:
            continue
        dtype: np.dtype = STORED_AS.get(values.dtype.str[1:], values.dtype)
        width = 1 if values.ndim == 1 else values.shape[1]
        if dtype.str[1:] not in DESCRIPTOR_TYPES or values.ndim > 2 or (width > 3 and dtype != np.uint8):
            raise DataError(f"{cloud.source}: column {name!r} ({values.dtype}, {values.shape}) cannot be stored in LAS")
        if len(name.encode()) > 32:
            raise DataError(
                f"{cloud.source}: column name {name!r} is longer than the 32 bytes that LAS allows: shorten it"
            )
        added.append(ExtraDimension.create(name, dtype, width))
    return added


def header_like(path: Path, cloud: PointCloud) -> las.LasHeader:
    """Return a file's header, with extra dimensions for columns of the cloud that the file lacks."""
    header = las.read_header(path)
    added = _extra_for(cloud, header)
    existing = list(header.extra_dimensions)
    return with_extra(header, added, existing=existing, source=cloud.source) if added else header


def new_header(cloud: PointCloud, options: WriteOptions) -> las.LasHeader:
    """Return a LAS 1.4 header for a cloud, without a date, so that the same points give the same bytes.

    It has point format 7 where there are colours, else 6, and WKT where there is a CRS. Longitudes and latitudes are
    stored in steps of `DEGREE_STEP`, all else by the scale and the units of the options.
    """
    point_format = 7 if any(name in cloud for name in DERIVED) else 6
    step = options.scale / options.metres
    flat = DEGREE_STEP if is_geographic(cloud.crs) else step
    new = las.LasHeader(bytes(las.HEADER_SIZES[4])).patched(
        **{"signature": las.SIGNATURE, "major": 1, "minor": 4, "system": b"OTHER", "software": SOFTWARE},
        **{"day": 1, "year": 1970, "encoding": las.WKT_BIT, "layout": point_format},
        record_size=las.RECORD_SIZES[point_format],
        scale=(flat, flat, step),
        offset=cloud.origin / options.metres,
    )
    header = with_wkt(new, cloud.crs)
    return with_extra(header, _extra_for(cloud, header), existing=[], source=cloud.source)


def with_room(header: las.LasHeader, cloud: PointCloud, metres: NDArray[np.float64]) -> las.LasHeader:
    """Set a scale and an offset in another file's header that can represent the points.

    The header is the same where they fit; else it has the offset of the cloud, and degrees in steps of `DEGREE_STEP`.
    """
    if not len(cloud):
        return header
    low, high = ((cloud.origin + f(cloud.xyz.astype(np.float64), axis=0)) / metres for f in (np.min, np.max))
    reach = np.maximum(np.abs(low - header.offset), np.abs(high - header.offset)) / np.abs(header.scale)
    if is_geographic(cloud.crs) and header.scale[:2].max() > DEGREE_STEP:
        return header.patched(scale=[DEGREE_STEP, DEGREE_STEP, header.scale[2]], offset=[0, 0, header.offset[2]])
    if (reach[:2] < 2**31 - 1).all():
        return header
    return header.patched(offset=[*np.floor(cloud.origin[:2] / metres[:2]), header.offset[2]])


def pack_records(
    cloud: PointCloud, header: las.LasHeader, *, metres: NDArray[np.float64] | None = None, depths: Depths | None = None
) -> NDArray:
    """Convert points to contiguous records; `DataError` if a coordinate or a value does not fit its field.

    A column goes to the dimension of its name; absent dimensions are zero, absent numbers of returns one. ``metres``
    are factors from the file's units (None: 1), ``depths`` the full scales of intensity and colours (None: all 16
    bits).
    """
    records = np.zeros(len(cloud), dtype=record_dtype(header))
    factors, depths = np.ones(3) if metres is None else metres, depths or Depths()
    for axis, (name, unit) in enumerate(zip("XYZ", factors.tolist(), strict=True)):
        world = (cloud.xyz[:, axis].astype(np.float64) + (cloud.origin[axis] - header.offset[axis] * unit)) / unit
        records[name] = _fitting(np.rint(world / header.scale[axis]), np.dtype("i4"), name, cloud.source)
    if not {"return_number", "number_of_returns"} & set(cloud.columns):
        records["bit_fields"] = SINGLE_RETURN[header.point_format >= 6]  # zero is no number of a return
    for name, values in _las_columns(cloud, depths):
        _store(records, header, name, values, cloud.source)
    return records


def _las_columns(cloud: PointCloud, depths: Depths) -> list[tuple[str, NDArray]]:
    columns = [(name, values) for name, values in cloud.columns.items() if name not in DERIVED]
    if "intensity" in cloud:
        whole = np.rint(np.nan_to_num(cloud["intensity"].astype(np.float64)) * depths.intensity)
        columns = [(name, whole if name == "intensity" else values) for name, values in columns]
    colours = cloud.get("rgb16")
    if colours is None and "rgb" in cloud:
        colours = cloud["rgb"].astype(np.uint16) * (1 if depths.colours == 8 else 257)
    if colours is not None:
        columns += [(name, colours[:, axis]) for axis, name in enumerate(("red", "green", "blue"))]
    return columns


def _store(records: NDArray, header: las.LasHeader, name: str, values: NDArray, source: str) -> None:
    bits = bit_field(header, name)
    if bits is not None:
        largest = bits.mask >> bits.shift
        if len(values) and not 0 <= values.min() <= values.max() <= largest:
            raise DataError(
                f"{source}: {name} {values.max()} does not fit point format {header.point_format}, "
                f"which holds 0 to {largest}"
            )
        records[bits.field] |= _fitting(values, np.dtype("u1"), name, source) << bits.shift
        return
    extra = extra_dimension(header, name)
    values = values if extra is None else extra.stored(values)
    dtype = records.dtype[name].base
    records[name] = values if values.dtype == dtype else _fitting(values, dtype, name, source)


def _fitting(values: NDArray, dtype: np.dtype, name: str, source: str) -> NDArray:
    """Return values in a narrower type; raise `DataError` where one does not fit."""
    if dtype.kind == "f" or not len(values):
        return values.astype(dtype)
    limits = np.iinfo(dtype)
    low, high = values.min(), values.max()
    if not limits.min <= low <= high <= limits.max:
        raise DataError(f"{source}: {name} {low} to {high} does not fit the file's {dtype} field")
    whole = values.astype(dtype)
    if values.dtype.kind == "f" and (whole != values).any():
        fraction = values[whole != values][0]
        raise DataError(f"{source}: {name} has fractions, such as {fraction}, and the field is {dtype}")
    return whole
