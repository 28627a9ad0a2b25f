"""Models of the sky, against published figures and closed forms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pointsplat_addon.core.sky import medium, preetham, scattering, spectrum
from pointsplat_addon.core.sky.medium import Atmosphere, scattering_often, scattering_once
from pointsplat_addon.core.sky.often import OftenScattered
from pointsplat_addon.core.sky.sky import Disc, Sky

UP = np.array([0.0, 0.0, 1.0])


def towards(elevation: float, azimuth: float = 0.0) -> tuple[float, float, float]:
    e, a = np.radians([elevation, azimuth])
    return float(np.cos(e) * np.cos(a)), float(np.cos(e) * np.sin(a)), float(np.sin(e))


def test_the_observer_sees_equal_energy_as_white() -> None:
    total = spectrum.OBSERVER.sum(axis=0) * spectrum.STEP
    assert total == pytest.approx(total.mean(), rel=4e-3)  # measured 1e-3: 20 nm apart
    assert total[1] == pytest.approx(106.857, rel=2e-3)  # the integral of the observer's y in nm (CIE 15:2004)


def test_the_sun_shines_as_a_black_body_of_its_temperature() -> None:
    irradiance = spectrum.sun_irradiance()
    assert spectrum.WAVELENGTHS[irradiance.argmax()] == 500  # Wien: 502 nm
    # The solar constant, 1361 W/m2, by Stefan and Boltzmann's law with the same temperature and solid angle
    assert 5.670374e-8 * spectrum.SUN_KELVIN**4 * spectrum.SUN_SOLID_ANGLE / np.pi == pytest.approx(1361, rel=3e-3)


def test_air_scatters_as_tabled() -> None:
    """Bucholtz 1995, table 3: 1.149e-5 per metre at 550 nm, 15 C."""
    air = scattering_once(Atmosphere()).scattering[0]
    at_550 = np.exp(np.interp(np.log(550), np.log(spectrum.WAVELENGTHS), np.log(air)))
    assert at_550 == pytest.approx(1.149e-5, rel=0.08)  # at 20 C, and without what makes molecules no spheres
    four = medium.MOLECULES_SCATTER
    ratio = np.log(four[3] / four[0]) / np.log(630 / 430)
    assert ratio == pytest.approx(4.1, abs=0.03)  # a little above 4: the index of refraction grows


def test_the_zenith_of_preetham_is_that_of_the_formula() -> None:
    """By hand for turbidity 3 and the sun in the zenith: chi = (4/9 - 1/40) pi."""
    luminance, x, y = preetham.zenith_of(0.0, 3.0)
    chi = (4 / 9 - 3 / 120) * np.pi
    assert luminance == pytest.approx((4.0453 * 3 - 4.971) * np.tan(chi) - 0.2155 * 3 + 2.4192)
    assert x == pytest.approx(0.00394 * 3 + 0.25886)
    assert y == pytest.approx(0.00516 * 3 + 0.26688)


def test_the_zenith_is_its_own_color() -> None:
    sun = np.array(towards(30.0))
    color = preetham.preetham(UP[None], sun, 4.0)[0]
    xyz = np.linalg.solve(spectrum.RGB_FROM_XYZ, color)
    luminance, x, y = preetham.zenith_of(np.radians(60.0), 4.0)
    assert xyz[1] == pytest.approx(preetham.LUMINANCE * luminance)
    assert xyz[:2] / xyz.sum() == pytest.approx([x, y])


@pytest.mark.parametrize("phase", ["once", "often"])
def test_phase_functions_of_aerosols_are_shares(phase: str) -> None:
    one = {"once": scattering_once, "often": scattering_often}[phase](Atmosphere())
    nodes, weights = np.polynomial.legendre.leggauss(64)
    assert 2 * np.pi * (one.phase(nodes) * weights).sum() == pytest.approx(1, abs=1e-9)  # measured 1e-12


def test_vertical_depths_are_closed_forms() -> None:
    """Of exponential layers their height, of the layer of ozone half its width."""
    one = scattering_once(Atmosphere())
    ground = np.array([[0.0, 0.0, one.ground]])
    along = scattering.densities_along(one, ground, UP[None], 4000)[0]
    assert along[:2] == pytest.approx([8000 * (1 - np.exp(-7.5)), 1200.0], rel=1e-5)
    assert along[2] == pytest.approx(15000.0, rel=1e-5)


def test_thin_air_scatters_by_the_closed_form() -> None:
    """Without aerosols, ozone or extinction to speak of, the zenith is phase x sun x vertical depth."""
    one = scattering_once(Atmosphere(air=1e-6, aerosol=0.0, ozone=0.0))
    one = replace(one, steps=2000)
    sun = np.array(towards(35.0))
    got = scattering.scattered(UP[None], sun, one)[0]
    depth = one.scattering[0] * 8000 * (np.exp(-1 / 8000) - np.exp(-7.5))
    want = one.irradiance * depth * 3 / (16 * np.pi) * (1 + sun[2] ** 2)
    np.testing.assert_allclose(got, want, rtol=2e-4)  # measured 8e-5, float32


def test_steps_of_skies_converge() -> None:
    """The steps of Cycles, which skies that scatter once have, beside eight times as many."""
    one = scattering_once(Atmosphere())
    fine = replace(one, steps=256, steps_to_sun=128, exact_steps=True)
    direction = np.array([towards(e, a) for e in (5.0, 20.0, 45.0, 80.0) for a in (0.0, 40.0, 120.0)])
    sun = np.array(towards(40.0))
    got, want = (scattering.scattered(direction, sun, x) @ x.rgb for x in (one, fine))
    error = np.abs(got / want - 1)
    assert error.max() < 0.25  # measured 0.19, at 5 degrees


def test_the_sun_is_dimmed_by_what_is_above() -> None:
    one = scattering_often(Atmosphere(altitude=3000.0))
    above = np.exp(-scattering.densities_along(one, one.eye[None], UP[None], 20000) @ one.extinction)
    np.testing.assert_allclose(scattering.sun_through(UP[None], one), above * one.irradiance, rtol=3e-4)
    assert not scattering.sun_through(-UP[None], one).any()


def test_light_that_is_scattered_often_is_lost_nowhere_without_absorption() -> None:
    """A white furnace of one layer: without ground, ozone or absorption the share that scatters again stays below 1."""
    one = scattering_often(Atmosphere(ozone=0.0, aerosol=0.0))
    often = OftenScattered(one)
    at = np.array([[0.0, 0.0, one.ground + 100.0]])
    high, low, night = (often(at, np.array(towards(e)))[0] for e in (80.0, 5.0, -12.0))
    assert (high > low).all()
    assert (low > night).all()
    assert (night >= 0).all()
    # Of blue light, of which most is scattered again, there is most of what the sun sends.
    share = high / one.irradiance
    assert (np.diff(share) > 0).all()


@pytest.mark.parametrize("model", ["SINGLE_SCATTERING", "MULTIPLE_SCATTERING"])
def test_tables_of_skies_are_what_they_are_of(model: str) -> None:
    sky = Sky(model, towards(25.0, 70.0))
    rng = np.random.default_rng(3)
    elevation, azimuth = np.arcsin(rng.uniform(0.02, 1, 300)), rng.uniform(0, 2 * np.pi, 300)
    flat = np.cos(elevation)
    direction = np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)], axis=1)
    often = OftenScattered(sky.medium) if model == "MULTIPLE_SCATTERING" else None
    want = scattering.scattered(direction, np.array(sky.sun), sky.medium, often) @ sky.medium.rgb
    error = np.abs(sky.radiance(direction) / want - 1)
    assert error.max() < 0.003  # measured 0.0019


def test_what_the_disc_sends_is_the_sun() -> None:
    """The integral of the limb's darkening is 0.8 of the disc: 1 - 0.6 (1 - 2/3)."""
    sky = Sky("SINGLE_SCATTERING", towards(50.0, 20.0))
    disc = Disc(sky, 0.005)
    direction, solid_angle = disc.directions(20000)
    assert np.linalg.norm(direction, axis=1) == pytest.approx(1)
    got = disc.radiance(direction).sum(axis=0) * solid_angle
    want = 0.8 * scattering.sun_through(np.array([sky.sun]), sky.medium)[0] @ sky.medium.rgb
    np.testing.assert_allclose(got, want, rtol=2e-3)
    away = np.array([towards(50.5, 20.0), towards(-50.0, 20.0)])
    assert not disc.radiance(away).any()
