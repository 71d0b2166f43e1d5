"""Known laser scanners, and scanners from configuration."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, replace
from typing import Any

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.simulation.parameters import multi_beam_scanners as beams
from mlsroad_pipeline.simulation.parameters.devices import Device, ScannerSystem


def _vmx450() -> ScannerSystem:
    # Two VQ-450: 550 kHz, 200 lines/s and 0.3 mrad each, 8 mm accuracy, 5 mm precision, 1.5 m to 140 m at full rate.
    one = Device(550e3, 200.0, (-0.25, 0.55, 0.8), yaw=45.0, pitch=20.0, min_range=1.5, max_range=140.0)
    return ScannerSystem("vmx450", (one, replace(one, lever=(-0.25, -0.55, 0.8), yaw=-45.0)))


def _vmq1ha() -> ScannerSystem:
    # One VUX-1HA class scanner: 1 MHz, 250 lines/s, 0.5 mrad, 5 mm accuracy, 3 mm precision, 1.2 m to 150 m.
    device = Device(
        1e6, 250.0, (-0.6, 0.0, 0.6), yaw=45.0, pitch=15.0, divergence=0.0005, range_noise=0.003,
        accuracy=0.005, min_range=1.2, max_range=150.0, max_returns=7,
    )  # fmt: skip
    return ScannerSystem("vmq1ha", (device,))


def _mx9() -> ScannerSystem:
    # Trimble MX9 with two heads of 1 MHz, 250 lines/s, 0.35 mrad each; accuracy 5 mm, precision 3 mm, 1.2 m to 150 m.
    one = Device(
        1e6, 250.0, (-0.4, 0.3, 0.5), yaw=30.0, pitch=25.0, divergence=0.00035, range_noise=0.003, accuracy=0.005,
        min_range=1.2, max_range=150.0,
    )  # fmt: skip
    return ScannerSystem("mx9", (one, replace(one, lever=(-0.4, -0.3, 0.5), yaw=-30.0)))


def _sick_side() -> ScannerSystem:
    # Two LMS 291: half a degree in 180 degrees at 37.5 Hz, 12 mrad, 1 cm steps, 80 m, 30 m at a reflectivity of 10 %.
    left = Device(
        27e3, 37.5, (0.0, 0.7, 0.1), field=(0.0, 180.0), divergence=0.012, range_noise=0.01, accuracy=0.035,
        range_step=0.01, min_range=0.5, max_range=80.0, max_returns=1, pulse_length=0.9, sensitivity=-14.5,
        blooming=0.02,
    )  # fmt: skip
    right = replace(left, lever=(0.0, -0.7, 0.1), field=(-180.0, 0.0))
    return ScannerSystem("sick_side", (left, right), platform=1.9, body=(-2.5, 2.0, -0.85, 0.85))


def _oakland() -> ScannerSystem:
    # One LMS 291 to the left, as fitted to the scan lines of the Oakland recordings (docs/simulator.md): half a degree,
    # 1.85 m above the road, from 12 degrees off the nadir upwards, free asphalt measured up to some 19 m.
    device = Device(
        27e3, 37.5, (0.0, 0.9, 0.05), field=(12.0, 180.0), divergence=0.012, range_noise=0.004, accuracy=0.02,
        range_step=0.01, min_range=0.5, max_range=80.0, max_returns=1, pulse_length=0.9, sensitivity=-14.5,
        blooming=0.02,
    )  # fmt: skip
    return ScannerSystem("oakland", (device,), platform=1.8, body=(-2.5, 2.0, -0.85, 0.85))


_LINE_SCANNERS = (_vmx450(), _vmq1ha(), _mx9(), _sick_side(), _oakland())
_MULTI_BEAM = (
    beams.hdl64(), beams.hdl32(), beams.vlp32(), beams.vlp32_front(), beams.vlp16(), beams.pandar64(), beams.pandaset(),
    beams.hesai_xt32(), beams.os1_64(), beams.os1_128(), beams.cyclomedia(),
)  # fmt: skip

SCANNERS: dict[str, ScannerSystem] = {system.name: system for system in (*_LINE_SCANNERS, *_MULTI_BEAM)}
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
