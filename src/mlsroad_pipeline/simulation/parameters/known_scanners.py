"""Known laser scanners, and scanners from configuration."""

from collections.abc import Mapping
from dataclasses import fields, replace
from functools import partial
from typing import Any

import numpy as np

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.simulation.parameters.devices import Device, ScannerSystem

_CAR = (-2.2, 1.2, -0.85, 0.85)  # roof of a car around a scanner above its middle, metres


def _pair(device: Device) -> tuple[Device, Device]:
    """Return a device on the left and its mirror image on the right."""
    x, y, z = device.lever
    low, high = device.field
    return device, replace(device, lever=(x, -y, z), yaw=0.0 - device.yaw, field=(0.0 - high, 0.0 - low))


# Two VQ-450: 550 kHz, 200 lines/s and 0.3 mrad each, 8 mm accuracy, 5 mm precision, 1.5 m to 140 m at full rate.
_VQ450 = Device(550e3, 200.0, (-0.25, 0.55, 0.8), yaw=45.0, pitch=20.0, min_range=1.5, max_range=140.0)
# One VUX-1HA class scanner: 1 MHz, 250 lines/s, 0.5 mrad, 5 mm accuracy, 3 mm precision, 1.2 m to 150 m.
_VUX1HA = Device(
    1e6, 250.0, (-0.6, 0.0, 0.6), yaw=45.0, pitch=15.0, divergence=0.0005, range_noise=0.003, accuracy=0.005,
    min_range=1.2, max_range=150.0, max_returns=7,
)  # fmt: skip
# Trimble MX9 with two heads of 1 MHz, 250 lines/s, 0.35 mrad each; accuracy 5 mm, precision 3 mm, 1.2 m to 150 m.
_MX9 = replace(_VUX1HA, lever=(-0.4, 0.3, 0.5), yaw=30.0, pitch=25.0, divergence=0.00035, max_returns=5)
# Two LMS 291: half a degree in 180 degrees at 37.5 Hz, 12 mrad, 1 cm steps, 80 m, 30 m at a reflectivity of 10 %.
_LMS291 = Device(
    27e3, 37.5, (0.0, 0.7, 0.1), field=(0.0, 180.0), divergence=0.012, range_noise=0.01, accuracy=0.035,
    range_step=0.01, min_range=0.5, max_range=80.0, max_returns=1, pulse_length=0.9, sensitivity=-14.5, blooming=0.02,
)  # fmt: skip
# One LMS 291 to the left, as fitted to the scan lines of the Oakland recordings (docs/simulator_streets.md): half a
# degree, 1.85 m above the road, from 12 degrees off the nadir upwards, free asphalt measured up to some 19 m.
_OAKLAND = replace(_LMS291, lever=(0.0, 0.9, 0.05), field=(12.0, 180.0), range_noise=0.004, accuracy=0.02)

# Rotating heads with several beams, as cars and mobile mappers carry them. Rates, beams, ranges and precision are those
# of the makers' data sheets. `sensitivity` follows from the range at a reflectivity of 10 %: 20 log10(range / 140 m).
# Heights are of the common carriers, or measured on recordings. Intensity is calibrated reflectivity.
_head = partial(
    Device, profile_rate=10.0, pitch=-90.0, divergence=0.003, accuracy=0.02, max_returns=1, pulse_length=0.75,
    blooming=0.006, corrected=True, turf_gain=2.0,
)  # fmt: skip
# 1.73 m above the road, as KITTI has it: 32 beams a third of a degree apart above 32 half a degree apart, some 1.33
# million pulses/s, 50 m at a reflectivity of 10 %. Each laser's power follows its returns in eight steps (the maker's
# manual); target, memory, scale of intensity and noise are fitted to two thirds of a recorded scan.
_HDL64 = _head(
    1.333e6, lever=(0.0, 0.0, 0.63), elevations=(*np.linspace(2.0, -8.33, 32), *np.linspace(-8.83, -24.8, 32)),
    divergence=0.002, range_noise=0.007, range_step=0.002, min_range=0.9, max_range=120.0, sensitivity=-10.0,
    blooming=0.008, corrected=False, intensity_scale=(5.0, 33.0), power_control=24.0, power_target=13.0,
    power_memory=128, gain_spread=1.5,
)  # fmt: skip
# 1.84 m above the road, as nuScenes has it: 32 beams 1.33 degrees apart, 0.695 million pulses/s, accuracy 2 cm, 80 to
# 100 m, about 40 m at 10 %.
_HDL32 = _head(
    695e3, profile_rate=20.0, lever=(0.0, 0.0, 0.74), elevations=tuple(np.linspace(10.67, -30.67, 32)),
    range_noise=0.008, range_step=0.002, min_range=1.0, max_range=105.0, sensitivity=-10.5,
)  # fmt: skip
# On a mapping car, tilted behind its panoramic camera, 2.9 m above the road. The firing cycle of 46.08 microseconds,
# 20 Hz, two returns and the noise are those of a recording from Amsterdam.
_CYCLOMEDIA = replace(
    _HDL32, lever=(-0.4, 0.0, 0.5), yaw=180.0, pitch=-60.0, range_noise=0.014, max_returns=2, min_range=1.5,
    max_range=90.0,
)  # fmt: skip
# 1.9 m above the road: 16 beams 2 degrees apart, 0.3 million pulses/s, accuracy 3 cm, 100 m, about 35 m at 10 %.
_VLP16 = _head(
    300e3, lever=(0.0, 0.0, 0.5), elevations=tuple(np.linspace(15.0, -15.0, 16)), range_noise=0.01, accuracy=0.03,
    range_step=0.002, min_range=0.5, max_range=100.0, sensitivity=-12.0,
)  # fmt: skip
# A VLP-32C 1.9 m above the road: 32 beams, dense about the horizon, 0.6 million pulses/s, accuracy 3 cm, 200 m, about
# 80 m at 10 %.
_UPPER = (15.0, 10.333, 7.0, 4.667, 3.333, 2.333)
_VLP32 = _head(
    600e3, lever=(0.0, 0.0, 0.5), elevations=(
        *_UPPER, *np.linspace(5 / 3, -4.0, 18), -4.667, -5.333, -6.148, -7.254, -8.843, -11.31, -15.639, -25.0,
    ), range_noise=0.01, accuracy=0.03, range_step=0.004, min_range=1.0, max_range=200.0, sensitivity=-5.0,
)  # fmt: skip
# 1.68 m above the road, looking ahead, as in the recordings of ika. Elevations and sector are those of the recordings:
# below -4 degrees an earlier generation than the VLP-32C. The bonnet hides the two lowest beams.
_VLP32_FRONT = replace(
    _VLP32, lever=(0.0, 0.0, 0.33), field=(-22.0, 24.0), elevations=(
        *_UPPER, *np.linspace(5 / 3, -13 / 3, 19), -4.667, -5.407, -6.407, -7.91, -10.281, -14.638, -25.0,
    ),
)  # fmt: skip
# 1.73 m above the road, the height of its rings on the ground in PandaSet. 64 beams: 0.167 degrees apart between +2 and
# -6, 1 to 6 degrees above and below; 1.152 million pulses/s, 0.2 degrees, 200 m at 10 %, accuracy 2 cm, steps of 4 mm.
_PANDAR64 = _head(
    1.152e6, lever=(0.0, 0.0, 0.28), elevations=(
        14.882, 11.032, 8.059, 5.057, 3.04, *np.linspace(2.028, -6.061, 49), -7.063, -8.059, -9.06, -9.885, -11.032,
        -12.006, -12.974, -13.93, -18.889, -24.897,
    ), divergence=0.0016, range_noise=0.008, range_step=0.004, min_range=1.0, max_range=230.0, sensitivity=3.0,
    blooming=0.004,
)  # fmt: skip
# Looks ahead beside the Pandar64 of PandaSet: a raster of 60 by 20 degrees without moving head, here 150 lines that
# repeat with 10 Hz; 1550 nm, 300 m at 10 %.
_PANDAR_GT = Device(
    3.9e6, 10.0, (0.35, 0.0, 0.0), pitch=-90.0, elevations=tuple(np.linspace(8.0, -12.0, 150)), field=(-30.0, 30.0),
    divergence=0.001, range_noise=0.01, accuracy=0.02, range_step=0.004, min_range=5.0, max_range=300.0, max_returns=1,
    sensitivity=6.5, corrected=True,
)  # fmt: skip
# 1.9 m above the road: 32 beams a degree apart, 0.64 million pulses/s, accuracy 1 cm, precision 5 mm, 120 m, 80 m at
# 10 %.
_XT32 = _head(
    640e3, lever=(0.0, 0.0, 0.5), elevations=tuple(np.linspace(15.0, -16.0, 32)), divergence=0.002, range_noise=0.005,
    accuracy=0.01, range_step=0.004, min_range=0.5, max_range=120.0, pulse_length=0.6, sensitivity=-5.0, blooming=0.004,
)  # fmt: skip
# Second generation, 1.8 m above the road, 1024 columns: 64 beams 0.71 degrees apart, 0.655 million pulses/s, 120 m,
# 45 m at 10 %, precision 1 to 3 cm, 865 nm.
_OS1 = _head(
    655_360.0, lever=(0.0, 0.0, 0.4), elevations=tuple(np.linspace(22.5, -22.5, 64)), divergence=0.0031,
    range_noise=0.012, accuracy=0.03, range_step=0.003, min_range=0.8, max_range=120.0, sensitivity=-10.0,
)  # fmt: skip
_OS1_128 = replace(_OS1, pulse_rate=1_310_720.0, elevations=tuple(np.linspace(22.5, -22.5, 128)))

_SYSTEMS = (
    ScannerSystem("vmx450", _pair(_VQ450)),
    ScannerSystem("vmq1ha", (_VUX1HA,)),
    ScannerSystem("mx9", _pair(_MX9)),
    ScannerSystem("sick_side", _pair(_LMS291), 1.9, (-2.5, 2.0, -0.85, 0.85)),
    ScannerSystem("oakland", (_OAKLAND,), 1.8, (-2.5, 2.0, -0.85, 0.85)),
    ScannerSystem("hdl64", (_HDL64,), 1.1, _CAR),
    ScannerSystem("hdl32", (_HDL32,), 1.1, _CAR),
    ScannerSystem("vlp32", (_VLP32,), 1.4, _CAR),
    ScannerSystem("vlp32_front", (_VLP32_FRONT,), 1.35, (-2.2, 1.7, -0.85, 0.85)),
    ScannerSystem("vlp16", (_VLP16,), 1.4, _CAR),
    ScannerSystem("pandar64", (_PANDAR64,), 1.45, _CAR),
    ScannerSystem("pandaset", (_PANDAR64, _PANDAR_GT), 1.45, _CAR),
    ScannerSystem("hesai_xt32", (_XT32,), 1.4, _CAR),
    ScannerSystem("os1_64", (_OS1,), 1.4, _CAR),
    ScannerSystem("os1_128", (_OS1_128,), 1.4, _CAR),
    ScannerSystem("cyclomedia", (_CYCLOMEDIA,), 2.4, (-1.2, 2.5, -0.9, 0.9)),
)
SCANNERS: dict[str, ScannerSystem] = {system.name: system for system in _SYSTEMS}
"""Known systems.

Line scanners: RIEGL VMX-450 and VMQ-1HA, Trimble MX9, SICK LMS 291 (a pair, and one as in Oakland). Rotating heads with
several beams: Velodyne HDL-64E, HDL-32E, VLP-32C (and a VLP-32 that looks ahead as in ika's recordings) and VLP-16,
Hesai Pandar64 (alone, and with a PandarGT as in PandaSet) and PandarXT-32, Ouster OS1-64 and OS1-128, and a tilted
HDL-32E as on Cyclomedia's cars.
"""


def scanner_system(config: str | Mapping[str, Any]) -> ScannerSystem:
    """Return the scanner system that a configuration describes."""
    if isinstance(config, str):
        if config not in SCANNERS:
            raise ParameterError(f"scanner {config!r} is unknown (scanners: {', '.join(SCANNERS)})")
        return SCANNERS[config]
    fields_left = dict(config)
    base = scanner_system(str(fields_left.pop("like"))) if "like" in fields_left else None
    devices = fields_left.pop("devices", None)
    own: dict[str, Any] = {key: fields_left.pop(key) for key in ("name", "platform", "body") if key in fields_left}
    _check_fields(fields_left)
    if devices is not None:
        if fields_left:
            raise ParameterError(f"scanner: {', '.join(sorted(fields_left))} must stand in each of its devices")
        own["devices"] = tuple(_device(one) for one in devices)
    if base is None:
        if "devices" not in own:
            raise ParameterError(f"scanner must have devices, or be like one of {', '.join(SCANNERS)}")
        return ScannerSystem(**{"name": "own", **own})
    return replace(base, **own).changed(**fields_left)


def _check_fields(config: Mapping[str, Any]) -> None:
    unknown = sorted(set(config) - {field.name for field in fields(Device)})
    if unknown:
        known = ", ".join(field.name for field in fields(Device))
        raise ParameterError(f"unknown fields of a scanner: {', '.join(unknown)} (known: {known})")


def _device(config: Mapping[str, Any]) -> Device:
    _check_fields(config)
    missing = [name for name in ("pulse_rate", "profile_rate") if name not in config]
    if missing:
        raise ParameterError(f"a scanner's device must have {' and '.join(missing)}")
    return Device(**config)
