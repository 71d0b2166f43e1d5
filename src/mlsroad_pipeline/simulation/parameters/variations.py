"""One car's scanner: how it differs from the system of its kind."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.core.validation import check_positive
from mlsroad_pipeline.simulation.model.meshes import rotation_matrix
from mlsroad_pipeline.simulation.parameters.devices import Device, ScannerSystem


@dataclass(frozen=True)
class Variation:
    """Changes of a scanner system and its mounting; the default changes nothing."""

    height: float = 0.0  # Added to the height above the road, metres
    # pitch, roll: turns of the whole system about the vehicle's y and x axes, degrees
    pitch: float = 0.0
    roll: float = 0.0
    # rate, noise: factors on the pulse rate, and so on the density along a profile, and on the range noise
    rate: float = 1.0
    noise: float = 1.0
    sensitivity: float = 0.0  # Added to the sensitivity, decibels
    dropout: float = 0.0  # Added to the share of returns that are lost
    field: tuple[float, float] | None = None  # First and last angle of the heads, degrees
    top: float | None = None  # Highest elevation of beams that are kept, degrees; two beams are kept at least
    # Amplitudes recorded as intensity 0 and 1; see `Device.intensity_scale`
    intensity: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        for name in ("rate", "noise"):
            check_positive(getattr(self, name), name)

    def applied(self, system: ScannerSystem) -> ScannerSystem:
        """Return the changed system."""
        devices = tuple(self._device(device) for device in system.devices)
        return replace(system, devices=devices, platform=system.platform + self.height)

    def _device(self, device: Device) -> Device:
        turn = rotation_matrix(0.0, *np.radians([self.pitch, self.roll])) @ device.mounting
        yaw, roll = np.arctan2(turn[1, 0], turn[0, 0]), np.arctan2(turn[2, 1], turn[2, 2])
        changes: dict[str, Any] = {
            "pulse_rate": device.pulse_rate * self.rate, "range_noise": device.range_noise * self.noise,
            "sensitivity": device.sensitivity + self.sensitivity, "dropout": device.dropout + self.dropout,
        }  # fmt: skip
        if self.pitch != 0 or self.roll != 0:
            angles = np.degrees([yaw, -np.arcsin(np.clip(turn[2, 0], -1.0, 1.0)), roll])
            changes |= dict(zip(("yaw", "pitch", "roll"), map(float, angles), strict=True))
        if self.field is not None:
            changes["field"] = self.field
        if self.top is not None and len(device.elevations) > 2:
            kept = tuple(e for e in device.elevations if e <= self.top) or device.elevations
            kept = kept if len(kept) > 1 else tuple(sorted(device.elevations)[:2])
            changes |= {
                "elevations": kept, "pulse_rate": changes["pulse_rate"] * len(kept) / len(device.elevations)
            }  # fmt: skip
        if self.intensity is not None:
            changes |= {"intensity_scale": self.intensity, "corrected": False}
        return replace(device, **changes)


def variation(config: Mapping[str, Any]) -> Variation:
    """Return the variation that a configuration describes."""
    known = [field.name for field in fields(Variation)]
    unknown = sorted(set(config) - set(known))
    if unknown:
        raise ParameterError(f"varied: unknown keys {', '.join(unknown)} (known: {', '.join(known)})")
    return Variation(**config)
