"""Laser scanners with several beams on a rotating head, as cars and mobile mappers carry them.

Rates, beams, ranges and precision are those of the makers' data sheets. `sensitivity` follows from the range at a
reflectivity of 10 %: 20 log10(range / 140 m). Heights are of the common carriers, or measured on recordings.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mlsroad_pipeline.simulation.parameters.devices import Device, ScannerSystem

_CAR = (-2.2, 1.2, -0.85, 0.85)  # roof of a car around a scanner above its middle, metres


def hdl64() -> ScannerSystem:
    """Return a Velodyne HDL-64E 1.73 m above the road, as KITTI has it."""
    # 32 beams a third of a degree apart above 32 half a degree apart, 10 Hz, some 1.33 million pulses/s, 50 m
    # at a reflectivity of 10 %. Each laser's power follows its returns in eight steps (the maker's manual); target,
    # memory, scale of intensity and noise are fitted to two thirds of a recorded scan.
    elevations = (*np.linspace(2.0, -8.33, 32), *np.linspace(-8.83, -24.8, 32))
    device = Device(
        1.333e6, 10.0, (0.0, 0.0, 0.63), pitch=-90.0, elevations=elevations, divergence=0.002, range_noise=0.007,
        accuracy=0.02, range_step=0.002, min_range=0.9, max_range=120.0, max_returns=1, pulse_length=0.75,
        sensitivity=-10.0, blooming=0.008, intensity_scale=(5.0, 33.0), power_control=24.0, power_target=13.0,
        power_memory=128, turf_gain=2.0, gain_spread=1.5,
    )  # fmt: skip
    return ScannerSystem("hdl64", (device,), platform=1.1, body=_CAR)


def hdl32() -> ScannerSystem:
    """Return a Velodyne HDL-32E 1.84 m above the road at 20 Hz, as nuScenes has it."""
    # 32 beams 1.33 degrees apart, 0.695 million pulses/s, accuracy 2 cm, 80 to 100 m, about 40 m at 10 %. Intensity is
    # calibrated reflectivity.
    device = Device(
        695e3, 20.0, (0.0, 0.0, 0.74), pitch=-90.0, elevations=tuple(np.linspace(10.67, -30.67, 32)), divergence=0.003,
        range_noise=0.008, accuracy=0.02, range_step=0.002, min_range=1.0, max_range=105.0, max_returns=1,
        pulse_length=0.75, sensitivity=-10.5, blooming=0.006, corrected=True, turf_gain=2.0,
    )  # fmt: skip
    return ScannerSystem("hdl32", (device,), platform=1.1, body=_CAR)


def vlp16() -> ScannerSystem:
    """Return a Velodyne VLP-16 1.9 m above the road."""
    # 16 beams 2 degrees apart, 0.3 million pulses/s, 10 Hz, accuracy 3 cm, 100 m, about 35 m at 10 %.
    device = Device(
        300e3, 10.0, (0.0, 0.0, 0.5), pitch=-90.0, elevations=tuple(np.linspace(15.0, -15.0, 16)), divergence=0.003,
        range_noise=0.01, accuracy=0.03, range_step=0.002, min_range=0.5, max_range=100.0, max_returns=1,
        pulse_length=0.75, sensitivity=-12.0, blooming=0.006, corrected=True, turf_gain=2.0,
    )  # fmt: skip
    return ScannerSystem("vlp16", (device,), platform=1.4, body=_CAR)


def vlp32() -> ScannerSystem:
    """Return a Velodyne VLP-32C 1.9 m above the road."""
    # 32 beams, dense about the horizon, 0.6 million pulses/s, 10 Hz, accuracy 3 cm, 200 m, about 80 m at 10 %.
    upper, lower = (15.0, 10.333, 7.0, 4.667, 3.333, 2.333), (-4.667, -5.333, -6.148, -7.254, -8.843, -11.31, -15.639)
    elevations = (*upper, *np.linspace(5 / 3, -4.0, 18), *lower, -25.0)
    device = Device(
        600e3, 10.0, (0.0, 0.0, 0.5), pitch=-90.0, elevations=elevations, divergence=0.003, range_noise=0.01,
        accuracy=0.03, range_step=0.004, min_range=1.0, max_range=200.0, max_returns=1, pulse_length=0.75,
        sensitivity=-5.0, blooming=0.006, corrected=True, turf_gain=2.0,
    )  # fmt: skip
    return ScannerSystem("vlp32", (device,), platform=1.4, body=_CAR)


def vlp32_front() -> ScannerSystem:
    """Return a Velodyne VLP-32 1.68 m above the road that looks ahead, as in the recordings of ika."""
    # Elevations and sector are those of the recordings: below -4 degrees an earlier generation than the VLP-32C. The
    # bonnet hides the two lowest beams.
    upper, lower = (15.0, 10.333, 7.0, 4.667, 3.333, 2.333), (-4.667, -5.407, -6.407, -7.91, -10.281, -14.638, -25.0)
    device = replace(
        vlp32().devices[0], lever=(0.0, 0.0, 0.33), elevations=(*upper, *np.linspace(5 / 3, -13 / 3, 19), *lower),
        field=(-22.0, 24.0),
    )  # fmt: skip
    return ScannerSystem("vlp32_front", (device,), platform=1.35, body=(-2.2, 1.7, -0.85, 0.85))


def _pandar64() -> Device:
    # 64 beams: 0.167 degrees apart between +2 and -6, 1 to 6 degrees above and below; 1.152 million pulses/s, 10 Hz,
    # 0.2 degrees, 200 m at 10 %, accuracy 2 cm, steps of 4 mm.
    upper = (14.882, 11.032, 8.059, 5.057, 3.04)
    lower = (-7.063, -8.059, -9.06, -9.885, -11.032, -12.006, -12.974, -13.93, -18.889, -24.897)
    return Device(
        1.152e6, 10.0, (0.0, 0.0, 0.28), pitch=-90.0, elevations=(*upper, *np.linspace(2.028, -6.061, 49), *lower),
        divergence=0.0016, range_noise=0.008, accuracy=0.02, range_step=0.004, min_range=1.0, max_range=230.0,
        max_returns=1, pulse_length=0.75, sensitivity=3.0, blooming=0.004, corrected=True, turf_gain=2.0,
    )  # fmt: skip


def pandar64() -> ScannerSystem:
    """Return a Hesai Pandar64 1.73 m above the road, the height of its rings on the ground in PandaSet."""
    return ScannerSystem("pandar64", (_pandar64(),), platform=1.45, body=_CAR)


def pandaset() -> ScannerSystem:
    """Return a Hesai Pandar64 and a PandarGT that looks ahead, as PandaSet has them."""
    # PandarGT: a raster of 60 by 20 degrees without moving head, here 150 lines that repeat with 10 Hz; 1550 nm, 300 m
    # at 10 %.
    front = Device(
        3.9e6, 10.0, (0.35, 0.0, 0.0), pitch=-90.0, elevations=tuple(np.linspace(8.0, -12.0, 150)),
        field=(-30.0, 30.0), divergence=0.001, range_noise=0.01, accuracy=0.02, range_step=0.004, min_range=5.0,
        max_range=300.0, max_returns=1, sensitivity=6.5, corrected=True,
    )  # fmt: skip
    return ScannerSystem("pandaset", (_pandar64(), front), platform=1.45, body=_CAR)


def hesai_xt32() -> ScannerSystem:
    """Return a Hesai PandarXT-32 1.9 m above the road."""
    # 32 beams a degree apart, 0.64 million pulses/s, 10 Hz, accuracy 1 cm, precision 5 mm, 120 m, 80 m at 10 %.
    device = Device(
        640e3, 10.0, (0.0, 0.0, 0.5), pitch=-90.0, elevations=tuple(np.linspace(15.0, -16.0, 32)), divergence=0.002,
        range_noise=0.005, accuracy=0.01, range_step=0.004, min_range=0.5, max_range=120.0, max_returns=1,
        sensitivity=-5.0, blooming=0.004, corrected=True, turf_gain=2.0,
    )  # fmt: skip
    return ScannerSystem("hesai_xt32", (device,), platform=1.4, body=_CAR)


def os1_64() -> ScannerSystem:
    """Return an Ouster OS1-64 of the second generation 1.8 m above the road, 1024 columns at 10 Hz."""
    # 64 beams 0.71 degrees apart, 0.655 million pulses/s, 120 m, 45 m at 10 %, precision 1 to 3 cm, 865 nm.
    device = Device(
        655_360.0, 10.0, (0.0, 0.0, 0.4), pitch=-90.0, elevations=tuple(np.linspace(22.5, -22.5, 64)),
        divergence=0.0031, range_noise=0.012, accuracy=0.03, range_step=0.003, min_range=0.8, max_range=120.0,
        max_returns=1, pulse_length=0.75, sensitivity=-10.0, blooming=0.006, corrected=True, turf_gain=2.0,
    )  # fmt: skip
    return ScannerSystem("os1_64", (device,), platform=1.4, body=_CAR)


def os1_128() -> ScannerSystem:
    """Return an Ouster OS1-128: the beams of `os1_64` twice as dense."""
    half = os1_64()
    beams = tuple(np.linspace(22.5, -22.5, 128))
    return replace(half, name="os1_128", devices=(replace(half.devices[0], pulse_rate=1_310_720.0, elevations=beams),))


def cyclomedia() -> ScannerSystem:
    """Return a mapping car with a tilted HDL-32E behind its panoramic camera, 2.9 m above the road."""
    # The firing cycle of 46.08 microseconds, 20 Hz, two returns and the noise are those of a recording from Amsterdam.
    device = replace(
        hdl32().devices[0], lever=(-0.4, 0.0, 0.5), yaw=180.0, pitch=-60.0, range_noise=0.014, max_returns=2,
        min_range=1.5, max_range=90.0,
    )  # fmt: skip
    return ScannerSystem("cyclomedia", (device,), platform=2.4, body=(-1.2, 2.5, -0.9, 0.9))
