"""Laser scanners and their mounting, and how one car's scanner differs from the system of its kind."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from numbers import Integral, Real
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.algorithms.core.validation import check_positive
from mlsroad_pipeline.simulation.model.meshes import rotation_matrix

Triple = tuple[float, float, float]


@dataclass(frozen=True)
class Device:
    """One scanner: a turning head with one beam or several.

    The head turns about the device's x axis. At angle 0 a beam without elevation leaves along -z of the device, at 90
    degrees along +y; `elevations` lift beams from that plane towards +x. Without yaw, pitch and roll the device's axes
    are the vehicle's (x forward, y left, z up), so profiles stand across the street and angle 0 is down; with a pitch
    of -90 degrees the axis is upright and angle 0 is straight ahead.

    Parameters
    ----------
    pulse_rate : float
        Pulses per second of all beams together, while the head is within `field`.
    profile_rate : float
        Revolutions per second.
    lever : tuple of float, default (0.0, 0.0, 0.0)
        Position on the vehicle, metres from the origin of its frame.
    yaw, pitch, roll : float, default 0.0
        Mounting Rz(yaw) Ry(pitch) Rx(roll), degrees.
    elevations : tuple of float, default (0.0,)
        Elevation of each beam out of the plane of rotation, degrees; beams fire cyclically.
    field : tuple of float, default (-180.0, 180.0)
        First and last angle of the head at which it emits, degrees.
    divergence : float, default 0.0003
        Full angle of the beam, radians. Larger mixes more surfaces at edges.
    range_noise : float, default 0.005
        Precision: standard deviation of a strong return's range, metres.
    accuracy : float, default 0.008
        Bound on the systematic error of ranges, metres; half of it is the standard deviation of the device's bias.
    range_step : float, default 0.0
        Quantisation of ranges, metres; 0 is continuous.
    min_range, max_range : float, default 1.2, 120.0
        Bounds of the recorded ranges, metres.
    max_returns : int, default 5
        Number of returns kept per pulse, the strongest ones, 1 to 8.
    pulse_length : float, default 0.6
        Distance along one pulse below which surfaces mix into one return, metres.
    sensitivity : float, default 0.0
        Decibels above or below a receiver that detects a reflectivity of 10 % at some 140 m.
    blooming : float, default 0.0
        Angle along a profile over which saturated returns bloom, radians.
    corrected : bool, default False
        Whether intensity is range-corrected reflectance instead of amplitude.
    intensity_scale : tuple of float or None, default None
        Amplitudes recorded as intensity 0 and 1, decibels, linear in between: as received, with the effects of
        sensitivity and power. None is 0 and 50 for an ideal receiver at full power.
    power_control : float, default 0.0
        Largest reduction of a beam's power while its returns are strong, decibels; 0 is a fixed power.
    power_target : float, default 13.0
        Target amplitude of the control, decibels. Lower values lose dark surfaces beside bright ones.
    power_memory : int, default 64
        Number of a beam's returns over which the control averages. Fewer level out the contrast between materials.
    turf_gain : float, default 0.0
        Backscatter of grass above that of rough ground of the same reflectivity, decibels: its blades face low beams,
        and living leaves are brighter near 905 nm than near 1550 nm.
    gain_spread : float, default 0.0
        Standard deviation of the beams' residual gains in the intensity, decibels.
    dropout : float, default 0.002
        Share of returns that are lost whatever their amplitude, 0 to 0.9.

    Raises
    ------
    ParameterError
        If a value is outside its domain.
    """

    pulse_rate: float
    profile_rate: float
    lever: Triple = (0.0, 0.0, 0.0)
    yaw: float = 0.0
    pitch: float = 0.0
    roll: float = 0.0
    elevations: tuple[float, ...] = (0.0,)
    field: tuple[float, float] = (-180.0, 180.0)
    divergence: float = 0.0003
    range_noise: float = 0.005
    accuracy: float = 0.008
    range_step: float = 0.0
    min_range: float = 1.2
    max_range: float = 120.0
    max_returns: int = 5
    pulse_length: float = 0.6
    sensitivity: float = 0.0
    blooming: float = 0.0
    corrected: bool = False
    intensity_scale: tuple[float, float] | None = None
    power_control: float = 0.0
    power_target: float = 13.0
    power_memory: int = 64
    turf_gain: float = 0.0
    gain_spread: float = 0.0
    dropout: float = 0.002

    def __post_init__(self) -> None:
        for name in ("pulse_rate", "profile_rate", "divergence", "max_range", "pulse_length"):
            check_positive(getattr(self, name), name)
        for name in ("range_noise", "accuracy", "range_step", "min_range", "blooming", "power_control", "gain_spread"):
            if not (isinstance(getattr(self, name), Real) and 0 <= getattr(self, name) < 100):
                raise ParameterError(f"{name} must be between 0 and 100, got {getattr(self, name)!r}")
        if not (isinstance(self.dropout, Real) and 0 <= self.dropout <= 0.9):
            raise ParameterError(f"dropout must be between 0 and 0.9, got {self.dropout!r}")
        for name in ("yaw", "pitch", "roll", "sensitivity", "power_target", "turf_gain"):
            if not (isinstance(getattr(self, name), Real) and np.isfinite(getattr(self, name))):
                raise ParameterError(f"{name} must be finite, got {getattr(self, name)!r}")
        for name, size in (("lever", 3), ("field", 2)):
            object.__setattr__(self, name, _floats(getattr(self, name), name, size))
        object.__setattr__(self, "elevations", _floats(self.elevations, "elevations", None))
        if max(np.abs(self.elevations)) >= 90:
            raise ParameterError(f"elevations must be within 90 degrees, got {self.elevations!r}")
        if not -180 <= self.field[0] < self.field[1] <= 180:
            raise ParameterError(f"field must be two rising angles within -180 to 180 degrees, got {self.field!r}")
        self._check_intensity()
        if self.max_returns not in range(1, 9):
            raise ParameterError(f"max_returns must be between 1 and 8, got {self.max_returns!r}")
        if self.min_range >= self.max_range:
            raise ParameterError(f"min_range must be below max_range {self.max_range!r}, got {self.min_range!r}")
        if self.pulse_rate < 16 * self.profile_rate * len(self.elevations):
            raise ParameterError(
                f"pulse_rate must be at least 16 pulses per profile, got {self.pulse_rate!r} for "
                f"profile_rate {self.profile_rate!r}"
            )

    def _check_intensity(self) -> None:
        if self.intensity_scale is not None:
            object.__setattr__(self, "intensity_scale", _floats(self.intensity_scale, "intensity_scale", 2))
            if self.intensity_scale[0] >= self.intensity_scale[1]:
                raise ParameterError(f"intensity_scale must be two rising amplitudes, got {self.intensity_scale!r}")
            if self.corrected:
                raise ParameterError("intensity is either corrected or on an intensity_scale, not both")
        if not isinstance(self.power_memory, Integral) or self.power_memory < 1:
            raise ParameterError(f"power_memory must be an integer >= 1, got {self.power_memory!r}")

    @property
    def mounting(self) -> NDArray[np.float64]:
        """Rotation from the device's axes to the vehicle's, shape (3, 3)."""
        return rotation_matrix(*np.radians([self.yaw, self.pitch, self.roll]))

    @property
    def step(self) -> float:
        """Angle between two pulses of one beam, radians."""
        return float(2 * np.pi * self.profile_rate * len(self.elevations) / self.pulse_rate)


@dataclass(frozen=True)
class ScannerSystem:
    """Scanners on a vehicle.

    Parameters
    ----------
    name : str
        Name of the system.
    devices : tuple of Device
        One to eight scanners; their index is the column `scanner`.
    platform : float, default 2.35
        Height of the vehicle's frame above the road, metres.
    body : tuple of float, default (-0.05, 5.0, -1.0, 1.0)
        Bounds of the vehicle, which occludes rays, below its frame: from, to along x; from, to along y; metres.

    Raises
    ------
    ParameterError
        If a value is outside its domain.
    """

    name: str
    devices: tuple[Device, ...]
    platform: float = 2.35
    body: tuple[float, float, float, float] = (-0.05, 5.0, -1.0, 1.0)

    def __post_init__(self) -> None:
        if not 1 <= len(self.devices) <= 8:
            raise ParameterError(f"scanner {self.name!r} must have 1 to 8 devices, got {len(self.devices)}")
        check_positive(self.platform, "platform")
        object.__setattr__(self, "body", _floats(self.body, "body", 4))

    @property
    def box(self) -> NDArray[np.float64]:
        """The vehicle in its own frame: from and to along x, y and z, shape (3, 2)."""
        return np.array([self.body[:2], self.body[2:], (-self.platform, 0.0)])

    def changed(self, **changes: Any) -> ScannerSystem:
        """Return the system with fields of all its devices changed; None leaves a field unchanged."""
        fields: dict[str, Any] = {name: value for name, value in changes.items() if value is not None}
        return replace(self, devices=tuple(replace(device, **fields) for device in self.devices)) if fields else self


def _floats(values: Any, name: str, size: int | None) -> tuple[float, ...]:
    try:
        numbers = tuple(float(value) for value in values)
    except (TypeError, ValueError) as error:
        raise ParameterError(f"{name} must be numbers, got {values!r}") from error
    if not numbers or (size is not None and len(numbers) != size) or not np.isfinite(numbers).all():
        raise ParameterError(f"{name} must be {size or 'some'} finite numbers, got {values!r}")
    return numbers


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
