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
continuous between the layers, P_rR = −p λ_z r/R on the inner surface and 0 on the outer one:
:func:`inflate` shoots on the inner radius. λ_r follows from P_rR; for κ = ∞ it is 1/(λ_θ λ_z), and
the pressure of the constraint follows from P_rR.

Millimetres and kPa.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

KPA_PER_MMHG = 0.1333223684


@dataclass(frozen=True, slots=True)
class Layer:
    """One layer of the wall: reference radii [mm], the fibres' angle, the opening angle, and Λ."""

    inner: float
    outer: float
    angle: float  # degrees
    opening: float = 0.0  # degrees
    stretch: float = 1.0

    def stress_free_stretches(self, R: float) -> tuple[float, float, float]:
        """Return G_r, G_θ, G_z at a radius, the stretches towards the layer without stress."""
        k = 360.0 / (360.0 - self.opening)
        middle = (self.inner + self.outer) / 2.0
        λ = k * R / np.sqrt((k * middle) ** 2 + k * self.stretch * (R**2 - middle**2))
        return λ * self.stretch, 1.0 / λ, 1.0 / self.stretch


LAYERS = (Layer(0.71, 0.97, 29.0), Layer(0.97, 1.10, 62.0))


@dataclass(frozen=True, slots=True)
class Wall:
    """Parameters of the wall's energy W, its layers, and its axial stretch.

    Attributes:
        c: Stiffness of the matrix material [kPa].
        k1: Stiffness of the fibres [kPa].
        k2: Exponent of the fibres.
        kappa: κ [kPa]; ∞ for an incompressible tube.
        layers: From the inside.
        stretch: λ_z.
    """

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
        inner = self.wall.layers[0].inner
        outer = self.wall.layers[-1].outer
        area = (self.radius(outer) ** 2 - self.radius(inner) ** 2) / (outer**2 - inner**2)
        return self.wall.stretch * area


def inflate(pressure: float, wall: Wall) -> Tube:
    """Return the tube under an inner pressure [kPa], for any κ."""
    start = wall.layers[0].inner
    if np.isfinite(wall.kappa):
        start = inflate(pressure, replace(wall, kappa=np.inf)).radius(start)
    r_i = _root(lambda r: _integrate(pressure, wall, r)[-1].y[1, -1], start)
    solutions = _integrate(pressure, wall, r_i, dense=True)

    def at(R: float) -> tuple[float, float, float, float]:
        """Return λ_r, λ_θ, P_rR and P_θΘ at R."""
        layer = _layer_at(wall, R)
        r, RP = solutions[wall.layers.index(layer)].sol(R)
        stretch_r, P_t = _radial(wall, layer, R, r / R, RP / R)
        return stretch_r, r / R, RP / R, P_t

    def stress(R: float) -> tuple[float, float]:
        stretch_r, stretch_t, P_r, P_t = at(R)
        return P_r / (stretch_t * wall.stretch), P_t / (stretch_r * wall.stretch)  # σ = P Fᵀ / J

    def jacobian(R: float) -> float:
        stretch_r, stretch_t, *_ = at(R)
        return stretch_r * stretch_t * wall.stretch

    return Tube(wall, pressure, lambda R: at(R)[1] * R, jacobian, stress)


def _energy(wall: Wall, angle: float, stretches: Sequence[complex]) -> complex:
    """Return W [kPa] of the elastic stretches λ_r, λ_θ, λ_z, without κ if it is infinite."""
    λ_r, λ_t, λ_z = stretches
    J = λ_r * λ_t * λ_z
    cosine2 = np.cos(np.radians(angle)) ** 2
    E = J ** (-2 / 3) * (λ_t**2 * cosine2 + λ_z**2 * (1 - cosine2)) - 1
    W = wall.c / 2 * (J ** (-2 / 3) * (λ_r**2 + λ_t**2 + λ_z**2) - 3)
    if E.real > 0:
        W += wall.k1 / wall.k2 * (np.exp(wall.k2 * E**2) - 1)
    return W + wall.kappa / 2 * (J - 1) ** 2 if np.isfinite(wall.kappa) else W


def _stresses(
    wall: Wall, layer: Layer, R: float, stretch_r: float, stretch_t: float
) -> tuple[float, float]:
    """Return ∂W/∂λ_r and ∂W/∂λ_θ [kPa] by a complex step, W' = Im W(λ + i h)/h."""
    G_r, G_t, G_z = layer.stress_free_stretches(R)
    elastic = (stretch_r / G_r, stretch_t / G_t, wall.stretch / G_z)
    h = 1e-30
    P_r = _energy(wall, layer.angle, (elastic[0] + 1j * h / G_r, *elastic[1:])).imag / h
    P_t = _energy(wall, layer.angle, (elastic[0], elastic[1] + 1j * h / G_t, elastic[2])).imag / h
    return P_r, P_t


def _integrate(pressure: float, wall: Wall, r_i: float, dense: bool = False) -> list[Any]:
    """Integrate (r, R P_rR) outwards, layer by layer, from P_rR = −p λ_z r/R inside."""
    state = np.array([r_i, -pressure * wall.stretch * r_i])
    solutions: list[Any] = []
    for layer in wall.layers:

        def slope(R: float, y: np.ndarray, layer: Layer = layer) -> tuple[float, float]:
            return _radial(wall, layer, R, y[0] / R, y[1] / R)

        ends = (layer.inner, layer.outer)
        tolerances = {"rtol": 1e-10, "atol": 1e-12}
        solutions.append(solve_ivp(slope, ends, state, "DOP853", dense_output=dense, **tolerances))
        state = solutions[-1].y[:, -1]
    return solutions


def _layer_at(wall: Wall, R: float) -> Layer:
    """Return the layer at R; outside of the wall the nearest one."""
    interfaces = [layer.outer for layer in wall.layers[:-1]]
    return wall.layers[np.searchsorted(interfaces, R)]


def _radial(wall: Wall, layer: Layer, R: float, stretch_t: float, P: float) -> tuple[float, float]:
    """Return the λ_r near J = 1 at which P_rR = P, and P_θΘ there."""
    isochoric = 1.0 / (stretch_t * wall.stretch)
    if not np.isfinite(wall.kappa):
        P_r, P_t = _stresses(wall, layer, R, isochoric, stretch_t)
        return isochoric, P_t + (P - P_r) * isochoric / stretch_t

    def residual(stretch_r: float) -> float:
        return _stresses(wall, layer, R, stretch_r, stretch_t)[0] - P

    low = 0.9 * isochoric
    high = 1.1 * isochoric
    while residual(low) > 0:
        low *= 0.8
    while residual(high) < 0:
        high *= 1.25
    found = brentq(residual, low, high, xtol=1e-15, rtol=4 * np.finfo(float).eps)
    return found, _stresses(wall, layer, R, found, stretch_t)[1]


def _root(function: Callable[[float], float], start: float) -> float:
    """Return a root of an increasing function, bracketed from ``start`` upwards or downwards."""
    low = start
    high = 1.05 * start
    step = 0.05 * start
    while function(low) > 0.0:
        low, high = 0.95 * low, low
    while function(high) < 0.0:
        low = high
        high = high + step
    return brentq(function, low, high, xtol=1e-13, rtol=1e-13)
