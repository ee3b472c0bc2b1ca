# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Semi-analytical solution of the inflated two-layer tube: no finite elements, no UFL.

A tube with the axial stretch λ_z, 1 or a prestretch, moves by R ↦ r(R), with principal stretches
λ_r = r', λ_θ = r/R and λ_z, and J = λ_r λ_θ λ_z. Both fibre families lie at ±α from the
circumference, hence have the same

    Ī₄ = J^{-2/3} (λ_θ² cos²α + λ_z² sin²α),

and the energy per unit reference volume is

    W = κ/2 (J − 1)² + c/2 (J^{-2/3} (λ_r² + λ_θ² + λ_z²) − 3) + k₁/k₂ (exp(k₂ ⟨Ī₄ − 1⟩²) − 1).

A layer that opens by an angle α when it is cut, and is stretched by Λ along the axis when it is put
in, has residual stress: W is that of the elastic stretches λ_r/G_r, λ_θ/G_θ, λ_z/G_z, where with
its middle radius ρ₀ and k = 2π/(2π − α)

    G_θ = 1/λ,  G_z = 1/Λ,  G_r = λ Λ,  λ = k R / √((k ρ₀)² + k Λ (R² − ρ₀²)).

With P_rR = ∂W/∂λ_r and P_θΘ = ∂W/∂λ_θ equilibrium is d(R P_rR)/dR = P_θΘ; r and R P_rR are
continuous between the layers, P_rR = −p λ_z r/R on the inner surface and 0 on the outer one.
:func:`compressible` shoots on the inner radius. For κ → ∞ the tube is isochoric,
r² = r_i² + (R² − R_i²)/λ_z, and :func:`incompressible` needs one quadrature of
p = ∫ (σ_θθ − σ_rr) dr/r.

Millimetres and kPa.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.integrate import quad, solve_ivp
from scipy.optimize import brentq

KPA_PER_MMHG = 0.1333223684

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Layer:
    """One layer of the wall: reference radii [mm], the fibres' angle, the opening angle, and Λ."""

    inner: float
    outer: float
    angle: float  # degrees
    opening: float = 0.0  # degrees
    stretch: float = 1.0

    def free(self, R: float) -> tuple[float, float, float]:
        """Return G_r, G_θ, G_z at a radius, the stretches towards the layer without stress."""
        k, middle = 360.0 / (360.0 - self.opening), (self.inner + self.outer) / 2.0
        λ = k * R / np.sqrt((k * middle) ** 2 + k * self.stretch * (R**2 - middle**2))
        return λ * self.stretch, 1.0 / λ, 1.0 / self.stretch


LAYERS = (Layer(0.71, 0.97, 29.0), Layer(0.97, 1.10, 62.0))


@dataclass(frozen=True, slots=True)
class Wall:
    """Parameters of W [kPa, kPa, -, kPa]; κ = ∞ is the incompressible tube; λ_z."""

    c: float = 3.0
    k1: float = 2.3632
    k2: float = 0.8393
    kappa: float = np.inf
    layers: tuple[Layer, ...] = LAYERS
    stretch: float = 1.0


@dataclass(frozen=True, slots=True)
class Tube:
    """An inflated tube; functions of the reference radius R [mm]."""

    wall: Wall
    pressure: float  # inside [kPa]
    radius: Callable[[float], float]  # r(R) [mm]
    jacobian: Callable[[float], float]  # J(R)
    stress: Callable[[float], tuple[float, float]]  # Cauchy's (σ_rr, σ_θθ) [kPa]; the inner layer's

    @property
    def inner_displacement(self) -> float:
        """u_r on the inner surface [mm]."""
        inner = self.wall.layers[0].inner
        return self.radius(inner) - inner

    @property
    def thickness(self) -> float:
        """Deformed thickness [mm]."""
        return self.radius(self.wall.layers[-1].outer) - self.radius(self.wall.layers[0].inner)

    @property
    def mean_jacobian(self) -> float:
        """Deformed over reference volume of the wall."""
        inner, outer = self.wall.layers[0].inner, self.wall.layers[-1].outer
        area = (self.radius(outer) ** 2 - self.radius(inner) ** 2) / (outer**2 - inner**2)
        return self.wall.stretch * area


def inflate(pressure: float, wall: Wall) -> Tube:
    """The tube under an inner pressure [kPa], for any κ."""
    return (compressible if np.isfinite(wall.kappa) else incompressible)(pressure, wall)


def stresses(
    wall: Wall, angle: float, stretch_r: float, stretch_t: float, stretch_z: float
) -> tuple[float, float]:
    """First Piola stresses P_rR = ∂W/∂λ_r and P_θΘ = ∂W/∂λ_θ [kPa], without κ if it is infinite."""
    cosine2 = np.cos(np.radians(angle)) ** 2
    J = stretch_r * stretch_t * stretch_z
    scale = J ** (-2.0 / 3.0)
    I1 = stretch_r**2 + stretch_t**2 + stretch_z**2
    I4 = scale * (stretch_t**2 * cosine2 + stretch_z**2 * (1.0 - cosine2))
    E = max(I4 - 1.0, 0.0)
    fibre = 2.0 * wall.k1 * E * np.exp(wall.k2 * E * E)  # dW/dĪ₄, both families
    P_r = wall.c * scale * (stretch_r - I1 / (3.0 * stretch_r))
    P_r -= fibre * 2.0 * I4 / (3.0 * stretch_r)
    P_t = wall.c * scale * (stretch_t - I1 / (3.0 * stretch_t))
    P_t += fibre * (2.0 * scale * stretch_t * cosine2 - 2.0 * I4 / (3.0 * stretch_t))
    if np.isfinite(wall.kappa):
        P_r += wall.kappa * (J - 1.0) * stretch_t * stretch_z
        P_t += wall.kappa * (J - 1.0) * stretch_r * stretch_z
    return P_r, P_t


def _stresses(
    wall: Wall, layer: Layer, R: float, stretch_r: float, stretch_t: float
) -> tuple[float, float]:
    """P_rR and P_θΘ [kPa] of a layer with residual stress."""
    G_r, G_t, G_z = layer.free(R)
    P_r, P_t = stresses(wall, layer.angle, stretch_r / G_r, stretch_t / G_t, wall.stretch / G_z)
    return P_r / G_r, P_t / G_t  # ∂W/∂λ at det G = 1


def incompressible(pressure: float, wall: Wall) -> Tube:
    """The limit κ → ∞ in closed form."""
    R_i, R_o, λ = wall.layers[0].inner, wall.layers[-1].outer, wall.stretch
    breaks = [layer.outer for layer in wall.layers[:-1]]

    def radius(R: float, r_i: float) -> float:
        return float(np.sqrt(r_i**2 + (R**2 - R_i**2) / λ))

    def difference(R: float, r_i: float) -> float:
        """(σ_θθ − σ_rr)/r · dr/dR, σ_θθ − σ_rr = λ_θ P_θΘ − λ_r P_rR on λ_r = 1/(λ_θ λ_z)."""
        r = radius(R, r_i)
        stretch_r, stretch_t = R / (r * λ), r / R
        P_r, P_t = _stresses(wall, _layer_at(wall, R), R, stretch_r, stretch_t)
        return (P_t * stretch_t - P_r * stretch_r) * stretch_r / r

    def carried(r_i: float, R: float) -> float:
        inside = [b for b in breaks if b < R] or None
        return quad(difference, R_i, R, (r_i,), points=inside, epsabs=1e-13, epsrel=1e-12)[0]

    r_i = _root(lambda r: carried(r, R_o) - pressure, R_i)

    def stress(R: float) -> tuple[float, float]:
        radial = carried(r_i, R) - pressure
        return radial, radial + difference(R, r_i) * radius(R, r_i) ** 2 * λ / R

    return Tube(wall, pressure, lambda R: radius(R, r_i), lambda R: 1.0, stress)


def compressible(pressure: float, wall: Wall) -> Tube:
    """The two-point problem at a finite κ by shooting on the inner radius."""
    start = incompressible(pressure, replace(wall, kappa=np.inf)).radius(wall.layers[0].inner)
    r_i = _root(lambda r: _integrate(pressure, wall, r)[-1].y[1, -1], start)
    solutions = _integrate(pressure, wall, r_i, dense=True)

    def at(R: float) -> tuple[float, float, float, float]:
        """λ_r, λ_θ, P_rR, P_θΘ."""
        layer = _layer_at(wall, R)
        r, RP = solutions[wall.layers.index(layer)].sol(R)
        stretch_r = _radial_stretch(wall, layer, R, r / R, RP / R)
        return stretch_r, r / R, *_stresses(wall, layer, R, stretch_r, r / R)

    def stress(R: float) -> tuple[float, float]:
        stretch_r, stretch_t, P_r, P_t = at(R)
        return P_r / (stretch_t * wall.stretch), P_t / (stretch_r * wall.stretch)  # σ = P Fᵀ / J

    def jacobian(R: float) -> float:
        stretch_r, stretch_t, *_ = at(R)
        return stretch_r * stretch_t * wall.stretch

    return Tube(wall, pressure, lambda R: at(R)[1] * R, jacobian, stress)


def _integrate(pressure: float, wall: Wall, r_i: float, dense: bool = False) -> list[Any]:
    """Integrate (r, R P_rR) outwards, layer by layer, from P_rR = −p λ_z r/R inside."""
    state: Floats = np.array([r_i, -pressure * wall.stretch * r_i])
    solutions: list[Any] = []
    for layer in wall.layers:

        def slope(R: float, y: Floats, layer: Layer = layer) -> list[float]:
            stretch_r = _radial_stretch(wall, layer, R, y[0] / R, y[1] / R)
            return [stretch_r, _stresses(wall, layer, R, stretch_r, y[0] / R)[1]]

        ends = (layer.inner, layer.outer)
        tolerances = {"rtol": 1e-10, "atol": 1e-12}
        solutions.append(solve_ivp(slope, ends, state, "DOP853", dense_output=dense, **tolerances))
        state = solutions[-1].y[:, -1]
    return solutions


def _layer_at(wall: Wall, R: float) -> Layer:
    """The layer around R; the nearest one outside the wall."""
    interfaces = [layer.outer for layer in wall.layers[:-1]]
    return wall.layers[np.searchsorted(interfaces, R)]


def _radial_stretch(wall: Wall, layer: Layer, R: float, stretch_t: float, P: float) -> float:
    """The λ_r at which P_rR has a given value, near J = 1."""

    def residual(stretch_r: float) -> float:
        return _stresses(wall, layer, R, stretch_r, stretch_t)[0] - P

    low, high = (near / (stretch_t * wall.stretch) for near in (0.9, 1.1))
    while residual(low) > 0:
        low *= 0.8
    while residual(high) < 0:
        high *= 1.25
    return brentq(residual, low, high, xtol=1e-15, rtol=4 * np.finfo(float).eps)


def _root(function: Callable[[float], float], start: float) -> float:
    """The first root around ``start`` of an increasing function: up from it, or else down."""
    low, high, step = start, 1.05 * start, 0.05 * start
    while function(low) > 0.0:
        low, high = 0.95 * low, low
    while function(high) < 0.0:
        low, high = high, high + step
    return brentq(function, low, high, xtol=1e-13, rtol=1e-13)
