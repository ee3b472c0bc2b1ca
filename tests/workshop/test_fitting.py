# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Fits find known parameters, and their intervals cover them as often as stated."""

from __future__ import annotations

import numpy as np
import pytest
from workshop_materials import HGO, JIT, hgo, material, mooney_rivlin, neo_hookean

import ufl

from dolfinx_feti import ConvergenceError
from dolfinx_feti.workshop import (
    DataSet,
    biaxial,
    equibiaxial,
    fit,
    plot_responses,
    respond,
    simple_shear,
    uniaxial,
)
from dolfinx_feti.workshop.fitting import uncertainty
from dolfinx_feti.workshop.response import stresses

pytestmark = pytest.mark.serial

STRETCH = np.linspace(1.02, 1.4, 12)
RUBBER = {"c10": 2.0, "c01": 0.5}


def measured(psi, parameters, path, *, noise=0.0, seed=0, measure="piola", kappa=np.inf, **other):
    """Return synthetic data with noise."""
    exact = stresses(respond(material(psi, kappa=kappa, **parameters), path), measure)
    errors = noise * np.random.default_rng(seed).standard_normal(exact.shape)
    return DataSet(path, exact + errors, measure=measure, **other)


@pytest.mark.parametrize("kappa", [np.inf, 200.0])
def test_exact_data_give_the_parameters(kappa):
    """A fit to exact data finds their parameters."""
    data = [
        measured(mooney_rivlin, RUBBER, uniaxial(STRETCH), measure="cauchy", kappa=kappa),
        measured(mooney_rivlin, RUBBER, biaxial(STRETCH, STRETCH**0.5), kappa=kappa),
        measured(mooney_rivlin, RUBBER, simple_shear(STRETCH - 1), kappa=kappa),
    ]
    found = fit(mooney_rivlin, data, {"c10": 1.0, "c01": 1.0}, kappa=kappa, jit_options=JIT)
    assert found.values == pytest.approx(RUBBER, rel=1e-7)
    assert found.material.kappa == kappa
    assert dict(found.material.parameters) == found.values


@pytest.mark.parametrize("seed", [11, 12])
def test_noisy_data_of_a_wall(seed):
    """From noisy strips and sheets of a wall, narrow 99.9 % intervals cover the parameters."""
    paths = uniaxial(STRETCH), uniaxial(STRETCH, along=(0, 1, 0)), equibiaxial(STRETCH)
    data = [measured(hgo, HGO, path, noise=0.05, seed=(seed, k)) for k, path in enumerate(paths)]
    start = {"c": 1.0, "k1": 1.0, "k2": 0.3}
    bounds = dict.fromkeys(HGO, (1e-3, 100.0))
    found = fit(hgo, data, start, bounds=bounds, confidence=0.999, jit_options=JIT)
    for name, (low, high) in found.intervals.items():
        assert low < HGO[name] < high and low < found.values[name] < high
        assert high - low < 0.2 * found.values[name]
    assert np.linalg.eigvalsh(found.correlation).min() > 0
    assert np.abs(found.correlation).max() == pytest.approx(1)


def slopes(path):
    """Return the stresses of rubber for c₁₀ = 1 and for c₀₁ = 1, (n, 2)."""
    units = {"c10": 1.0, "c01": 0.0}, {"c10": 0.0, "c01": 1.0}
    found = (respond(material(mooney_rivlin, **each), path) for each in units)
    return np.column_stack([stresses(response, "piola").ravel() for response in found])


def test_intervals_cover_as_often_as_they_say():
    """80 % intervals of a linear model cover the parameter in 80 % of the fits.

    The stresses of rubber are linear in c₁₀ and c₀₁, so that Student's t is exact. With 4000
    intervals the standard deviation is 0.6 %.
    """
    R = slopes(uniaxial(STRETCH))
    rng = np.random.default_rng(2003)
    hits = np.zeros(2)
    n = 4000
    for errors in rng.standard_normal((n, len(R))):
        shift, squares, *_ = np.linalg.lstsq(R, errors, rcond=None)
        _, half = uncertainty(R, squares[0], np.array([True, True]), 0.8)
        hits[np.abs(shift) < half] += 1
    np.testing.assert_allclose(hits / n, 0.8, atol=0.025)


def test_covariance_is_that_of_linear_regression():
    """For a linear model the covariance is that of linear regression."""
    data = [measured(mooney_rivlin, RUBBER, equibiaxial(STRETCH), noise=0.1, seed=5)]
    result = fit(mooney_rivlin, data, {"c10": 1.0, "c01": 1.0}, jit_options=JIT)
    R = slopes(data[0].path)
    best, squares, *_ = np.linalg.lstsq(R, data[0].stress.ravel(), rcond=None)
    assert list(result.values.values()) == pytest.approx(best.tolist(), rel=1e-7)
    covariance = squares[0] / (len(R) - 2) * np.linalg.inv(R.T @ R)
    np.testing.assert_allclose(result.covariance, covariance, rtol=1e-5)


def test_weights_count():
    """Of two contradicting data sets, the result is the mean weighted by squared weights."""
    pairs = ((2.0, 1.0), (4.0, 3.0))
    strip = uniaxial(STRETCH)
    data = [measured(neo_hookean, {"c": c}, strip, weight=weight) for c, weight in pairs]
    found = fit(neo_hookean, data, {"c": 1.0}, jit_options=JIT)
    assert found.values["c"] == pytest.approx((2 + 9 * 4) / 10, rel=1e-7)


def test_parameter_on_its_bound_has_no_interval():
    """A parameter on its bound has no confidence interval."""
    data = [measured(mooney_rivlin, {"c10": 2.0, "c01": 0.0}, uniaxial(STRETCH), noise=0.01)]
    bounds = {"c01": (0.1, 10.0)}
    found = fit(mooney_rivlin, data, {"c10": 1.0, "c01": 1.0}, bounds=bounds, jit_options=JIT)
    assert found.values["c01"] == pytest.approx(0.1, rel=1e-5)
    np.testing.assert_array_equal(found.intervals["c01"], np.nan)
    np.testing.assert_array_equal(np.isfinite(found.intervals["c10"]), True)
    np.testing.assert_array_equal(found.covariance[1], np.nan)
    assert found.covariance[0, 0] > 0
    assert "on its bound" in str(found)


def test_data_that_do_not_determine_a_parameter():
    """Simple shear, which determines only c₁₀ + c₀₁, gives unbounded intervals and a note."""
    data = [measured(mooney_rivlin, RUBBER, simple_shear(STRETCH - 1), noise=0.01)]
    result = fit(mooney_rivlin, data, {"c10": 1.0, "c01": 1.0}, jit_options=JIT)
    assert sum(result.values.values()) == pytest.approx(2.5, rel=0.05)
    assert set(result.intervals.values()) == {(-np.inf, np.inf)}
    assert str(result).count("not determined by the data") == 2
    np.testing.assert_array_equal(result.correlation, np.nan)


def test_tables():
    """A fit prints a table of parameters and one of data sets."""
    data = [measured(neo_hookean, {"c": 3.0}, uniaxial(STRETCH), noise=0.01, name="strip")]
    lines = str(fit(neo_hookean, data, {"c": 1.0}, jit_options=JIT)).splitlines()
    assert lines[0].split()[:3] == ["parameter", "value", "95"]
    assert lines[1].split()[0] == "c"
    assert lines[4].split()[:2] == ["strip", "12"]
    assert float(lines[4].split()[2]) == pytest.approx(0.01, rel=0.5)
    assert float(lines[4].split()[3]) > 0.99


# -- pictures ----------------------------------------------------------------------------------


def test_picture(tmp_path):
    """``plot_responses`` draws responses and data with labels, and refuses bad arguments."""
    pytest.importorskip("matplotlib")
    curves = [respond(material(hgo), path) for path in (uniaxial(STRETCH), simple_shear([0, 0.5]))]
    sheet = measured(hgo, HGO, equibiaxial(STRETCH), name="sheet")
    figure = plot_responses(curves, [sheet], measure="piola")
    (ax,) = figure.axes
    np.testing.assert_array_equal(ax.lines[0].get_ydata(), curves[0].P[:, 0, 0])
    np.testing.assert_array_equal(ax.lines[3].get_ydata(), sheet.stress[:, 1])
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("λ or γ", "first Piola stress [kPa]")
    figure.savefig(tmp_path / "fit.png")
    assert (tmp_path / "fit.png").stat().st_size > 5000
    (named,) = plot_responses(curves, names=["strip", "block"]).axes
    labels = [text.get_text() for text in named.get_legend().texts]
    assert labels == ["strip, σ$_{11}$", "block, σ$_{12}$"]
    for responses, wrong, match in (
        (curves, {"names": ["strip"]}, "give one for each of the 2 responses"),
        ([], {}, "give at least one response"),
        (curves, {"measure": "kirchhoff"}, "measure = 'kirchhoff'"),
    ):
        with pytest.raises(ValueError, match=match):
            plot_responses(responses, **wrong)


# -- bad input ---------------------------------------------------------------------------------

STRIP = uniaxial([1.0, 1.1, 1.2])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"stress": [1.0, 2.0]}, r"shape \(2,\): the uniaxial path with 3 states needs \(3, 1\)"),
        ({"path": equibiaxial([1.1, 1.2]), "stress": [1.0, 2.0]}, r"needs \(2, 2\)"),
        ({"stress": [1.0, np.nan, 2.0]}, "not finite: leave those states out"),
        ({"start": {}}, r"3 measured stresses cannot determine the parameters \[\]"),
        ({"data": []}, "0 measured stresses"),
        ({"bounds": {"k": (0, 1)}}, r"bounds has \['k'\], which start has not"),
        ({"bounds": {"c": (2.0, 3.0)}}, r"c = 1.0, and bounds has \(2.0, 3.0\): give"),
        ({"bounds": {"c": (1.0, 1.0)}}, "give a start between two different bounds"),
        ({"confidence": 95}, "confidence = 95: give a level"),
        ({"start": {"c": np.inf}}, "c = inf: give a finite value"),
    ],
)
def test_bad_input(arguments, message):
    """Data, starts and bounds that do not fit the energy are refused."""
    good = {"path": STRIP, "stress": [0.0, 1.0, 2.0], "start": {"c": 1.0}} | arguments
    with pytest.raises(ValueError, match=message):
        data = [DataSet(good.pop("path"), good.pop("stress"), measure="cauchy")]
        fit(**{"psi": neo_hookean, "data": data, "jit_options": JIT} | good)


def test_start_without_equilibrium():
    """If the start has no equilibrium, the error names data set, state and values."""
    path = equibiaxial([1.1, 3.0])
    data = [DataSet(path, np.ones((2, 2)), measure="cauchy", name="sheet")]
    with pytest.raises(ConvergenceError, match=r"no equilibrium at 1 states of sheet, .* λ = 3"):
        fit(hgo, data, {"c": 1.0, "k1": 1.0, "k2": 900.0}, jit_options=JIT)


def test_fit_that_leaves_the_domain_of_the_energy():
    """A fit driven out of the energy's domain is an error that says so."""
    data = [DataSet(STRIP, [0.0, -1.0, -2.0], measure="cauchy")]
    with pytest.raises(ConvergenceError, match="give bounds, or another start"):
        fit(lambda C, J, c: ufl.sqrt(c) * neo_hookean(C, J), data, {"c": 1.0}, jit_options=JIT)
